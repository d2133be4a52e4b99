"""The view-space march: laws of occlusion by a depth buffer, and a slow reference."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.relight.scenes import sky, sphere, surface
from yesnt.core.camera import Camera
from yesnt.core.distortion import UNDISTORTED, Distortion
from yesnt.relight import EnvMap, GBuffer, RelightSettings, prepare_light, shade
from yesnt.relight.lens import distorted, lens_record
from yesnt.relight.march import depth_scene, march
from yesnt.relight.occlusion import find_occluders, single_factor
from yesnt.relight.points import gather_pixels

SIZE, HEIGHT, FLOOR, TOP = 64, 0.4, 3.0, 2.6
STEPS = 24
RIGHT, LEFT = np.array([0.8, 0.0, 0.6]), np.array([-0.8, 0.0, 0.6])


def slab(half_width=8, z=TOP):
    """A floor 3 m below the camera; over its middle columns the depth buffer holds a slab 0.4 m above the floor."""
    pose = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, FLOOR], [0, 0, 0, 1]])
    camera = Camera(SIZE, SIZE, 1.0 * SIZE, 1.0 * SIZE, SIZE / 2, SIZE / 2, {1: pose})
    ones = np.ones((SIZE, SIZE), np.float32)
    depth = FLOOR * ones
    depth[:, SIZE // 2 - half_width : SIZE // 2 + half_width] = z
    normal = np.tile(np.float32([0, 0, 1]), (SIZE, SIZE, 1))
    return GBuffer(np.full((SIZE, SIZE, 3), 0.5, np.float32), ones, 0 * ones, normal, depth, ones), camera


def occluded(gbuffer, camera, directions, thickness):
    """[H, W, C] of a march from every pixel."""
    seen = surface(gbuffer, camera)
    pixels = gather_pixels(seen)
    columns = np.stack(directions, axis=1).astype(np.float32)
    found = march(depth_scene(seen, pixels, thickness), pixels.position, pixels.normal, columns, STEPS)
    return found.reshape(SIZE, SIZE, -1)


def reference(gbuffer, camera, directions, thickness, reach, which):
    """The definition, ray by ray in float64, for some pixels [N]: [N, C]."""
    pixels = gather_pixels(surface(gbuffer, camera))
    hidden = np.zeros((len(which), len(directions)), bool)
    for p, (position, normal) in enumerate(
        zip(pixels.position[which].astype(float), pixels.normal[which], strict=True)
    ):
        for c, direction in enumerate(directions):
            if normal @ direction <= 0:
                continue
            for i in range(1, STEPS + 1):
                distance = reach * (i / STEPS) ** 2
                column, row, z = camera.project(position + distance * np.asarray(direction), 1)
                if z <= 0 or not (0 <= column < SIZE and 0 <= row < SIZE):
                    break
                behind = z - gbuffer.z[int(row), int(column)]
                margin = 0.02 * distance + 2 * z / camera.fx
                if margin < behind < thickness + margin:
                    hidden[p, c] = True
                    break
    return hidden


def test_a_slab_occludes_the_light_behind_it_on_both_sides_and_nothing_else():
    found = occluded(*slab(), [RIGHT, LEFT, np.array([0.0, 0.0, 1.0])], thickness=HEIGHT)
    left, right = slice(19, 23), slice(41, 45)  # floor within 0.25 m of the slab's edges
    assert found[8:-8, left, 0].all()
    assert found[8:-8, right, 1].all()
    assert not found[:, left, 1].any()
    assert not found[:, right, 0].any()
    assert not found[..., 2].any()  # straight up: no pixel lies below another
    assert not found[:, :15].any()  # floor that rays leave above the slab
    assert not found[:, 24:40].any()  # the slab itself


def test_without_an_occluder_nothing_is_occluded():
    assert not occluded(*slab(half_width=0), [RIGHT, LEFT], thickness=HEIGHT).any()


def test_a_thin_slab_frees_what_passes_far_behind_it():
    """Rays along the floor pass up to 0.4 m below the slab's top."""
    low = np.array([0.995, 0.0, 0.0999])
    thick, thin = (occluded(*slab(), [low], thickness)[..., 0] for thickness in (HEIGHT, 0.05))
    assert thick[8:-8, 8:22].all()
    assert not thin[:, 8:22].any()
    assert not (thin & ~thick).any()


@pytest.mark.parametrize("direction", [RIGHT, LEFT, np.array([0.0, 0.6, 0.8])])
def test_a_larger_occluder_occludes_more(direction):
    """Floor pixels outside all slabs: what a slab occludes stays occluded, and more comes with its width."""
    floor = np.ones(SIZE, bool)
    floor[SIZE // 2 - 12 : SIZE // 2 + 12] = False
    found = [occluded(*slab(half), [direction], HEIGHT)[:, floor, 0] for half in (6, 8, 10, 12)]
    for smaller, larger in pairwise(found):
        assert not (smaller & ~larger).any()
    counts = [hidden.sum() for hidden in found]
    if direction[0] != 0:
        assert counts == sorted(set(counts))  # strictly growing
        assert counts[0] > 0


def test_directions_below_the_horizon_count_as_free():
    assert not occluded(*slab(), [np.array([0.8, 0.0, -0.6])], thickness=HEIGHT).any()


BENT = Distortion("brown", (-0.3, 0.05, 0.01, -0.02, 0.01, 0.02, 0.01, 0.01, 0.01, 0.001, -0.01, 0.001))
FISHEYE = Distortion("fisheye", (0.05, -0.01, 0.003, -0.001))


@pytest.mark.parametrize(
    ("thickness", "lens"), [(0.05, UNDISTORTED), (0.2, UNDISTORTED), (1.0, UNDISTORTED), (0.2, BENT), (0.2, FISHEYE)]
)
def test_march_equals_the_slow_reference(thickness, lens):
    gbuffer, camera = slab()
    camera = replace(camera, distortion=lens)
    rng = np.random.default_rng(0)
    bumps = rng.uniform(2.3, 3.0, (8, 8)).repeat(8, 0).repeat(8, 1).astype(np.float32)
    tilted = rng.normal(size=(SIZE, SIZE, 3)) * 0.3 + [0, 0, 1]
    gbuffer = replace(gbuffer, z=bumps, normal=tilted / np.linalg.norm(tilted, axis=-1, keepdims=True))
    directions = rng.normal(size=(6, 3)) + np.array([0, 0, 1])
    directions = list(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    seen, which = surface(gbuffer, camera), np.arange(0, SIZE * SIZE, 5)
    reach = float(depth_scene(seen, gather_pixels(seen), thickness).reach)
    found = occluded(gbuffer, camera, directions, thickness).reshape(SIZE * SIZE, -1)[which]
    expected = reference(gbuffer, camera, directions, thickness, reach, which)
    assert 0.05 < expected.mean() < 0.95
    assert (found != expected).mean() < 2e-3  # float32 at pixel borders and margins


def test_thickness_is_estimated_as_half_the_width_of_the_matte():
    gbuffer, camera = slab(half_width=SIZE // 2, z=FLOOR)
    covered = np.zeros((SIZE, SIZE), np.float32)
    covered[:, 20:40] = 1
    seen = surface(replace(gbuffer, opacity=covered), camera)
    assert np.isclose(depth_scene(seen, gather_pixels(seen), 0.0).thickness, 10 * FLOOR / camera.fx)
    assert np.isclose(depth_scene(seen, gather_pixels(seen), 0.7).thickness, 0.7)


def test_shade_without_a_proxy_darkens_the_floor_beside_the_slab():
    gbuffer, camera = slab()
    env = EnvMap.from_array(np.ones((16, 32, 3)))
    settings = RelightSettings.from_quality("draft", thickness=HEIGHT, edges=False)
    shading, free = (shade(gbuffer, env, camera, settings, shadows) for shadows in (True, False))
    assert shading.shadow[32, 22] < 0.9
    assert shading.shadow[32, 22] < shading.shadow[32, 2] <= 1
    assert shading.radiance[32, 22].mean() < 0.9 * free.radiance[32, 22].mean()
    assert np.allclose(shading.shadow[:, 28:36], 1, atol=1e-3)  # nothing lies above the slab


def test_a_convex_body_does_not_shadow_itself():
    gbuffer, camera = sphere()
    env = EnvMap.from_array(np.ones((16, 32, 3)))
    shading = shade(gbuffer, env, camera, RelightSettings.from_quality("draft", edges=False))
    assert shading.shadow[gbuffer.opacity > 0].mean() > 0.9


def test_the_single_factor_is_the_unoccluded_share_of_the_brightest_clusters():
    gbuffer, camera = slab()
    settings = RelightSettings.from_quality("draft", shadows="single", thickness=HEIGHT)
    light, seen = prepare_light(sky(), 64, 16), surface(gbuffer, camera)
    pixels = gather_pixels(seen)
    found = single_factor(find_occluders(seen, pixels, None, settings), pixels, slice(0, SIZE * SIZE), light, settings)
    power = light.clusters.energy.sum(axis=0)
    main = np.argsort(-power)[:8]
    hidden = occluded(gbuffer, camera, list(light.clusters.direction[:, main].T), HEIGHT).reshape(SIZE * SIZE, -1)
    assert np.allclose(found[:, 0], ((1 - hidden) * power[main]).sum(1) / power[main].sum(), atol=1e-6)
    assert found.min() < 1


@pytest.mark.parametrize("lens", [BENT, FISHEYE])
def test_kernels_distort_as_the_camera_does(lens):
    _, camera = slab()
    record = lens_record(replace(camera, distortion=lens), 1)
    for x, y in np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2)).astype(np.float32):
        assert distorted.py_func(x, y, record) == pytest.approx(lens.distort(np.float64(x), np.float64(y)), abs=1e-6)


def ball(rows, fy):
    """A ball of 1 m, 3 m ahead, seen by a camera of 64 columns whose pixels are as tall as `rows` makes them."""
    pose = np.array([[1.0, 0, 0, 0], [0, 0, 1, -3], [0, -1, 0, 0], [0, 0, 0, 1]])
    camera = Camera(64, rows, 100.0, fy, 32.0, rows / 2, {1: pose})
    rays, eye = camera.rays(1).astype(float), np.array([0, -3.0, 0])
    a, b = (rays**2).sum(-1), rays @ eye
    root = b * b - a * (9 - 0.25)
    hit = root > 0
    z = np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)
    normal = np.where(hit[..., None], (eye + z[..., None] * rays) / 0.5, 0).astype(np.float32)
    ones = np.ones((rows, 64), np.float32)
    return GBuffer(np.tile(0.5 * ones[..., None], 3), ones, 0 * ones, normal, z, hit.astype(np.float32)), camera


@pytest.mark.parametrize(("rows", "fy"), [(48, 100.0), (24, 50.0), (12, 25.0)])
def test_pixels_that_are_taller_than_wide_do_not_shadow_a_convex_surface(rows, fy):
    seen = surface(*ball(rows, fy))
    pixels = gather_pixels(seen)
    directions = np.random.default_rng(0).normal(size=(3, 64))
    directions = (directions / np.linalg.norm(directions, axis=0)).astype(np.float32)
    hidden = march(depth_scene(seen, pixels, 0.0), pixels.position, pixels.normal, directions, STEPS)
    assert hidden[pixels.normal @ directions > 0].mean() < 0.002
