"""Laws of the layers of a scene that was rendered with and without the subject."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.scene.composite import Behind, associate, into_set, over
from yesnt.scene.holdout import REACH, TOLERANCE, holdout_coverage, split_front
from yesnt.scene.scene_layers import scene_layers, shadow_ratio
from yesnt.scene.vertex_materials import MeasuredVertices, vertex_values

F32 = NDArray[np.float32]
HEIGHT, WIDTH, N = 12, 16, 4
NOTHING = np.float32(1e10)


def plates(seed: int = 0) -> tuple[F32, F32]:
    """A plate [H, W, 3] and its glossy part."""
    draw = np.random.default_rng(seed)
    radiance = draw.uniform(0.05, 2, (HEIGHT, WIDTH, 3)).astype(np.float32)
    return radiance, (radiance * draw.uniform(0, 0.6, (HEIGHT, WIDTH, 1))).astype(np.float32)


def step(edge: float) -> F32:
    """Depth [n H, n W] of a piece one metre away left of a column, nothing elsewhere."""
    x = (np.arange(WIDTH * N) + 0.5) / N
    return np.broadcast_to(np.where(x < edge, np.float32(1), NOTHING), (HEIGHT * N, WIDTH * N)).copy()


def test_a_piece_before_the_subject_has_the_soft_edge_of_a_plate() -> None:
    z, opacity = np.full((HEIGHT, WIDTH), 2, np.float32), np.ones((HEIGHT, WIDTH), np.float32)
    found = holdout_coverage(step(8.5), z, opacity)
    assert (found[:, :7] == 1).all()
    assert (found[:, 10:] == 0).all()
    np.testing.assert_allclose(found[:, 8], 0.5, atol=1e-6)  # the edge goes through the middle of its pixel
    between = holdout_coverage(step(9.0), z, opacity)[0]
    assert 0 < between[9] < 0.2  # the filter is 1.5 pixels wide: both neighbours see the edge
    np.testing.assert_allclose(between[8] + between[9], 1, atol=1e-6)


def test_the_ground_that_a_sole_touches_is_not_before_it() -> None:
    z, opacity = np.full((HEIGHT, WIDTH), 2, np.float32), np.ones((HEIGHT, WIDTH), np.float32)
    touching = np.full((HEIGHT * N, WIDTH * N), 2 - 0.9 * TOLERANCE, np.float32)
    assert (holdout_coverage(touching, z, opacity) == 0).all()
    assert (holdout_coverage(touching - np.float32(0.2 * TOLERANCE), z, opacity) == 1).all()


def test_nothing_is_held_out_far_from_the_subject_or_without_one() -> None:
    z, opacity = np.zeros((HEIGHT, 24), np.float32), np.zeros((HEIGHT, 24), np.float32)
    z[:, 20:], opacity[:, 20:] = 2, 1
    near = np.full((HEIGHT * N, 24 * N), 1, np.float32)
    found = holdout_coverage(near, z, opacity)
    assert (found[:, 20 - REACH :] == 1).all()
    assert (found[:, : 20 - REACH] == 0).all()
    assert (holdout_coverage(near, 0 * z, 0 * opacity) == 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_front_and_back_are_the_plate(seed: int) -> None:
    plate, _ = plates(seed)
    holdout = np.random.default_rng(seed).choice([0, 0.2, 0.5, 0.9, 1], (HEIGHT, WIDTH)).astype(np.float32)
    front, back = split_front(plate, holdout)
    assert front.min() >= 0
    assert back.min() >= 0
    np.testing.assert_allclose(front + (1 - holdout[..., None]) * back, plate, rtol=1e-5, atol=1e-6)


def test_an_edge_is_split_into_the_colours_on_its_sides() -> None:
    """A red piece before a blue set: the subject behind its edge gets no blue."""
    holdout = np.broadcast_to(np.array([1, 1, 1, 0.6, 0, 0, 0], np.float32), (5, 7)).copy()
    red, blue = np.array([1, 0.1, 0], np.float32), np.array([0, 0.2, 2], np.float32)
    plate = holdout[..., None] * red + (1 - holdout[..., None]) * blue
    front, back = split_front(plate, holdout)
    np.testing.assert_allclose(front[2, 3], 0.6 * red, atol=1e-6)
    np.testing.assert_allclose(back[2, 3], blue, atol=1e-6)
    green = associate(np.broadcast_to(np.array([0, 1, 0], np.float32), (5, 7, 3)), np.ones((5, 7), np.float32))
    one, none = np.ones_like(plate), np.zeros_like(plate)
    seen = into_set(green, Behind(associate(back, np.ones((5, 7), np.float32)), one, none, holdout, front))
    np.testing.assert_allclose(seen[2, 3, :3], 0.6 * red + 0.4 * np.array([0, 1, 0]), atol=1e-6)
    assert np.allclose(seen[..., 3], 1)


def test_layers_add_up_to_the_plate_with_the_subjects_effect() -> None:
    without, present = plates(1), plates(2)
    z, opacity = np.full((HEIGHT, WIDTH), 2, np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
    opacity[2:9, 3:12] = 0.7
    found = scene_layers(without, present, step(8.5), (z, opacity))
    total = found.front + (1 - found.holdout[..., None]) * (found.open * found.ratio + found.added)
    np.testing.assert_allclose(total, present[0], rtol=1e-4, atol=1e-5)
    assert (found.holdout[opacity == 0] == 0).all()
    assert (found.holdout[opacity > 0] > 0).any()


def test_a_subject_that_changes_nothing_leaves_the_ratio_at_exactly_1() -> None:
    plate = plates(3)
    assert (shadow_ratio(plate, plate) == 1).all()


def test_a_reflection_is_no_shadow_and_a_shadow_no_reflection() -> None:
    """A mirror that shows a dark subject scatters what it did before; a matt floor in shadow scatters less."""
    matt = np.full((HEIGHT, WIDTH, 3), 0.8, np.float32), np.zeros((HEIGHT, WIDTH, 3), np.float32)
    shaded = 0.25 * matt[0], matt[1]
    np.testing.assert_allclose(shadow_ratio(matt, shaded), 0.25, atol=1e-6)
    mirror = matt[0] + 1, matt[1] + 1
    dark = matt[0] + np.float32(0.1), matt[1] + np.float32(0.1)
    np.testing.assert_allclose(shadow_ratio(mirror, dark), 1, atol=1e-5)


def test_a_set_without_effect_is_a_plain_background() -> None:
    plate, _ = plates(4)
    relit = associate(plates(5)[0], np.random.default_rng(1).uniform(0, 1, (HEIGHT, WIDTH)).astype(np.float32))
    one, none, clear = np.ones_like(plate), np.zeros_like(plate), np.zeros((HEIGHT, WIDTH), np.float32)
    behind = Behind(associate(plate, clear + 1), one, none, clear, none)
    np.testing.assert_allclose(into_set(relit, behind), over(relit, plate), atol=1e-6)


def test_vertices_take_the_pixels_that_show_them_and_others_their_neighbours() -> None:
    """A strip seen from above its first half; the far half is hidden, and a loose triangle is joined to nothing."""
    camera = Camera(8, 8, 8.0, 8.0, 4.0, 4.0, {1: np.eye(4)})
    x = np.linspace(-0.9, 0.9, 4, dtype=np.float32)
    seen = np.stack([x, 0 * x, 0 * x + 2], axis=-1)
    hidden = seen + np.array([0, 0, 1], np.float32)
    loose = np.array([[9, 9, 5], [9, 10, 5], [10, 9, 5]], np.float32)
    vertices = np.concatenate([seen, hidden, loose]).astype(np.float32)
    faces = np.array([[i, i + 4, i] for i in range(4)] + [[8, 9, 10]], np.int32)
    values = np.arange(64, dtype=np.float32).reshape(8, 8, 1)
    z, opacity = np.full((8, 8), 2, np.float32), np.ones((8, 8), np.float32)
    found = vertex_values((vertices, faces), (camera, 1), values, opacity, z)[:, 0]
    column = np.floor(4 * x + 4)
    np.testing.assert_array_equal(found[:4], 32 + column)
    np.testing.assert_array_equal(found[4:8], found[:4])
    np.testing.assert_allclose(found[8:], values.mean())
    bare = vertex_values((vertices, faces), (camera, 1), values, 0 * opacity, z)
    assert (bare == 0).all()
    other = MeasuredVertices(np.full((11, 1), 7, np.float32), np.arange(11) % 4 == 0)
    both = vertex_values((vertices, faces), (camera, 1), values, opacity, z, other)[:, 0]
    np.testing.assert_array_equal(both[:4], found[:4], "the picture stands where it shows a vertex")
    np.testing.assert_array_equal(both[4:8], [7, *found[5:8]])
    np.testing.assert_array_equal(both[8:], 7, "neighbours of a measured vertex take its values")
