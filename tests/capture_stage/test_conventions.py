"""The conventions of method.md section 1, proven on pictures that Blender renders."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, map_coordinates
from scipy.spatial import ConvexHull

from yesnt.capture_stage import passes

from .conftest import cube_motion

pytestmark = pytest.mark.blender


def _stack(passes, name, channels):
    return np.stack([passes[f"{name}.{c}"] for c in channels], axis=-1).astype(np.float64)


def _sphere_normals(camera, frame, radius):
    """World normals where pixel-centre rays meet a ball about the origin, and where they do."""
    origin, rays = camera.position(frame), camera.rays(frame).astype(np.float64)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    half_b = rays @ origin
    inside = half_b**2 - (origin @ origin - radius**2)
    t = -half_b - np.sqrt(np.maximum(inside, 0))
    return (origin + t[..., None] * rays) / radius, rays, inside > 0


def test_a_chrome_ball_shows_the_map_where_our_mapping_says(tools, tmp_path, chrome_scene):
    _, lit = chrome_scene.render(tools, tmp_path, frame=1)
    normal, rays, hit = _sphere_normals(chrome_scene.camera(), 1, 0.5)
    mirrored = rays - 2 * (rays * normal).sum(-1, keepdims=True) * normal
    seen = (
        _stack(lit, "Combined", "RGB") / np.maximum(_stack(lit, "base_color", "RGB"), 1e-3) - 2
    )  # roughness varies over the layer
    step = np.linalg.norm(np.gradient(mirrored, axis=1), axis=-1)  # radians that a pixel spans
    off = np.linalg.norm(seen - mirrored, axis=-1) / step
    inner = hit & ((-rays * normal).sum(-1) > 0.6)  # Fresnel adds nothing there
    assert inner.sum() > 1000
    assert np.median(off[inner]) < 0.2
    assert np.percentile(off[inner], 95) < 0.5


def test_z_and_normals_are_ours(tools, tmp_path, cube_scene):
    points, lit = cube_scene.render(tools, tmp_path, frame=1)
    camera = cube_scene.camera()
    hit = points["Depth.Z"] < 1e9
    world = camera.position(1) + points["Depth.Z"][..., None] * camera.rays(1)
    rest = _to_rest(1, world[hit])
    assert np.abs(np.abs(rest).max(axis=1) - 0.3).max() < 1e-4
    octant = _stack(points, "base_color", "RGB")[hit]
    clear = (np.abs(rest) > 0.005).all(axis=1)
    assert clear.sum() > 500
    assert ((octant > 0.4) == (rest > 0))[clear].all()
    normal = _stack(passes.geometry(points, lit), "N", "XYZ")[hit]
    assert ((normal * camera.rays(1)[hit]).sum(axis=1) < 0).all()


def test_the_matte_lies_on_our_projection(tools, tmp_path, cube_scene):
    _, lit = cube_scene.render(tools, tmp_path, frame=1)
    camera = cube_scene.camera()
    hull = ConvexHull(camera.project(cube_scene.shapes[1], 1)[:, :2])
    size = lit["Combined.A"].shape[0]
    fine = (np.arange(size * 8) + 0.5) / 8
    x, y = np.meshgrid(fine, fine)
    inside = np.all([a * x + b * y + c < 0 for a, b, c in hull.equations], axis=0)
    ours, theirs = inside.reshape(size, 8, size, 8).mean(axis=(1, 3)), lit["Combined.A"]
    centers = [[(m * c).sum() / m.sum() for c in np.indices(m.shape)] for m in (ours, theirs)]
    assert np.abs(np.subtract(*centers)).max() < 0.05
    assert abs(ours.sum() / theirs.sum() - 1) < 0.01
    assert np.abs(ours - theirs).max() < 0.5


def test_flow_is_where_the_point_goes(tools, tmp_path, cube_scene):
    points, lit = cube_scene.render(tools, tmp_path, frame=1)
    camera = cube_scene.camera()
    hit = points["Depth.Z"] < 1e9
    rest = _to_rest(1, (camera.position(1) + points["Depth.Z"][..., None] * camera.rays(1))[hit])
    rotation, shift = cube_motion(2)
    pixels = np.stack(np.nonzero(hit)[::-1], axis=-1) + 0.5
    expected = camera.project(rest @ rotation.T + shift, 2)[:, :2] - pixels
    moved = _stack(passes.flow(points, lit), "forward", "uv")[hit]
    assert np.abs(expected).max() > 2
    assert np.percentile(np.linalg.norm(moved - expected, axis=1), 99) < 0.05


def test_warping_the_next_frame_by_flow_gives_this_one(tools, tmp_path, cube_scene):
    now_dir, next_dir = tmp_path / "now", tmp_path / "next"
    now_dir.mkdir()
    next_dir.mkdir()
    points, lit = cube_scene.render(tools, now_dir, frame=1)
    _, lit_next = cube_scene.render(tools, next_dir, frame=2)
    moved = _stack(passes.flow(points, lit), "forward", "uv")
    rows, columns = np.indices(moved.shape[:2])
    solid = binary_erosion(lit["Combined.A"] > 0.999, iterations=4)
    this, following = (_stack(passes, "base_color", "RGB") for passes in (lit, lit_next))
    errors = []
    for sign in (1, -1):
        at = [rows + sign * moved[..., 1], columns + sign * moved[..., 0]]
        warped = np.stack([map_coordinates(following[..., c], at, order=1) for c in range(3)], axis=-1)
        errors.append(np.abs(warped - this)[solid].mean())
    assert errors[0] < 0.02
    assert errors[0] < 0.2 * errors[1]


def _to_rest(frame, world):
    rotation, shift = cube_motion(frame)
    return (world - shift) @ rotation
