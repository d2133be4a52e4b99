"""Edges between surfaces of a set's mesh are soft."""

from __future__ import annotations

import numpy as np

from tests.relight.scenes import box_mesh
from tests.scene.set_scenes import camera, material
from yesnt.relight.proxy import ProxyScene
from yesnt.scene.set_view import SetImage, mesh_image

SIZE = (48, 64)


def seen(*boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> SetImage:
    """Boxes as one mesh, seen without a subject."""
    parts = [box_mesh(low, high) for low, high in boxes]
    faces = np.concatenate([f + 8 * i for i, (_, f) in enumerate(parts)])
    mesh = ProxyScene.from_arrays(np.concatenate([v for v, _ in parts]), faces)
    return mesh_image(mesh, material(), camera(SIZE), 1, np.zeros(SIZE, np.float32))


FLOOR, CRATE = ((-9, -9, -1), (9, 9, 0)), ((-0.5, -0.5, -0.1), (0.47, 0.5, 0.6))


def test_a_pixel_at_the_edge_of_a_piece_shows_as_much_of_it_as_its_rays_meet() -> None:
    image = seen(FLOOR, CRATE)
    pixels, mix = image.view.pixels, image.edges
    assert mix is not None
    on_crate = (pixels.position[:, 2] > 1e-3).astype(np.float32)
    found = mix.of(np.stack([on_crate, 1 - on_crate], axis=-1))
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-5)
    rays = camera((8 * SIZE[0], 8 * SIZE[1])).rays(1).reshape(-1, 3)
    unit = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    crate = ProxyScene.from_arrays(*box_mesh((-0.5, -0.5, 0.0), (0.47, 0.5, 0.6)))
    origin = np.broadcast_to(camera().position(1), unit.shape).astype(np.float32)
    met = (crate.first_hits(origin, unit) >= 0).reshape(SIZE[0], 8, SIZE[1], 8).mean(axis=(1, 3))
    covered = met.reshape(-1)[pixels.index]
    partly = (covered > 0.1) & (covered < 0.9)
    assert partly.sum() > 40
    assert np.abs(found[:, 0] - covered)[partly].mean() < 0.09, "four by four rays"
    assert np.abs(on_crate - covered)[partly].mean() > 0.2, "without it a pixel shows one surface"


def test_a_step_between_parallel_surfaces_is_an_edge_and_triangles_of_one_are_not() -> None:
    mix = seen(FLOOR).edges
    assert mix is not None
    assert not len(mix.pixel)
    step = seen(FLOOR, ((-9, 0.5, -1), (9, 9, 0.3))).edges
    assert step is not None
    assert len(step.pixel) >= SIZE[1]
