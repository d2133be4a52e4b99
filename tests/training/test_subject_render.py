"""Primary rays against the analytic intersection with a plane."""

import numpy as np
import pytest

from yesnt.capture_stage.cameras import look_at
from yesnt.core.camera import Camera
from yesnt.relight import ProxyScene
from yesnt.training import subject_render
from yesnt.training.subject_render import Subject, View, _coverage, render_subject
from yesnt.training.synthetic.materials import MATERIAL

WIDTH, HEIGHT, DISTANCE = 24, 16, 2.0


@pytest.fixture(scope="module")
def seen():
    """A right triangle in the plane y = 0, seen along +Y from (0, -2, 0); no edge meets a pixel centre."""
    pose = look_at(np.array([0.0, -DISTANCE, 0.0]), np.zeros(3))
    camera = Camera(WIDTH, HEIGHT, 12.0, 12.0, WIDTH / 2, HEIGHT / 2, {0: pose})
    vertices = np.array([[-1.0, 0, -1.0], [1.03, 0, -1.0], [-1.0, 0, 0.97]])
    faces = np.array([[0, 1, 2]], np.int32)
    scene = ProxyScene.from_arrays(vertices, faces)
    return camera, scene, vertices, View.look(camera, scene, faces)


def points(camera):
    """[H, W, 2] x and z where the ray through each pixel centre meets the plane."""
    rays = camera.rays(0)
    met = camera.position(0) + rays * (DISTANCE / rays[..., 1:2])
    return met[..., [0, 2]]


def inside(point):
    """Whether a point of the plane lies on the triangle."""
    return (point > -1).all(-1) & ((point[..., 0] + 1) / 2.03 + (point[..., 1] + 1) / 1.97 < 1)


def test_hits_depth_and_barycentric_weights_are_those_of_the_plane(seen):
    camera, _, vertices, view = seen
    expected = points(camera)
    np.testing.assert_array_equal(view.seen, inside(expected))
    assert 20 < view.seen.sum() < WIDTH * HEIGHT / 2
    np.testing.assert_allclose(view.z[view.seen], DISTANCE, rtol=1e-5)
    np.testing.assert_allclose(view.interpolate(vertices)[view.seen][:, [0, 2]], expected[view.seen], atol=1e-5)
    assert not view.weights[~view.seen].any()


def test_relighting_gets_world_normals_depth_and_materials(seen, monkeypatch):
    camera, _, vertices, view = seen
    received = []

    def recorded(rng, surface, base, scene):
        received.append((surface, base))
        return np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)

    monkeypatch.setattr(subject_render, "_lit", recorded)
    material = np.zeros(1, MATERIAL)
    material["base"], material["second"], material["roughness"], material["metallic"] = 0.25, 0.25, 0.6, 1
    subject = Subject(
        vertices, np.array([[0, 1, 2]], np.int32), np.tile([0.0, -1.0, 0.0], (3, 1)), np.zeros((3, 2)),
        lambda view: np.where(view.seen, 0, -1).astype(np.int32), material,
    )  # fmt: skip
    image = render_subject(np.random.default_rng(0), subject, camera)
    ((surface, base),) = received
    np.testing.assert_allclose(surface.normal[view.seen], np.broadcast_to([0, -1, 0], (view.seen.sum(), 3)), atol=1e-6)
    np.testing.assert_array_equal(surface.z, view.z)
    np.testing.assert_allclose(base[view.seen], 0.25)
    np.testing.assert_allclose(image.truth[:, view.seen], np.broadcast_to([[0.6], [1.0]], (2, view.seen.sum())))
    np.testing.assert_allclose(image.rgb, 0.5 * np.broadcast_to(image.matte, image.rgb.shape), err_msg="associated")


def test_coverage_is_the_fraction_of_four_rays_and_at_least_one_where_the_centre_hits(seen):
    camera, scene, _, view = seen
    covered = _coverage(camera, scene, view)
    expected = points(camera)
    step = np.array([expected[0, 1, 0] - expected[0, 0, 0], expected[1, 0, 1] - expected[0, 0, 1]])
    offsets = ((-0.25, -0.1), (0.1, -0.25), (0.25, 0.1), (-0.1, 0.25))
    count = sum(inside(expected + np.array(offset) * step).astype(int) for offset in offsets)
    np.testing.assert_allclose(covered, np.where(view.seen, np.maximum(count, 1) / 4, 0))
    assert set(np.unique(covered)) >= {0, 1}
    assert ((covered > 0) & (covered < 1)).any()
