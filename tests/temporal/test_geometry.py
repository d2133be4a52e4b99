"""Index lists of matte pixels: neighbours are neighbours, and stencils stay inside the next frame."""

import numpy as np
import pytest

from yesnt.temporal.geometry import FIXED, HAS_DOWN, HAS_RIGHT, build_geometry


def indices(matte):
    """[T, H, W] index of each matte pixel, -1 elsewhere."""
    index = np.full(matte.shape, -1)
    index[matte] = np.arange(np.count_nonzero(matte))
    return index


@pytest.mark.parametrize("seed", range(12))
def test_flags_and_the_pixel_below_are_those_of_the_matte(problem_drawn, seed):
    problem = problem_drawn(seed)
    geometry = build_geometry(problem.matte, problem.flow, problem.validity)
    index, wide = indices(problem.matte), np.pad(problem.matte, ((0, 0), (0, 1), (0, 1)))
    matte = problem.matte
    np.testing.assert_array_equal((geometry.flags & HAS_RIGHT) > 0, wide[:, :-1, 1:][matte])
    below = wide[:, 1:, :-1][matte]
    np.testing.assert_array_equal((geometry.flags & HAS_DOWN) > 0, below)
    np.testing.assert_array_equal(geometry.down[below], np.roll(index, -1, axis=1)[matte][below])
    assert geometry.pixels == np.count_nonzero(matte)


@pytest.mark.parametrize("seed", range(24))
def test_stencils_stay_inside_the_next_frame_and_weights_sum_to_one(problem_drawn, seed):
    """Also those without a weight: kernels write through them, and another thread owns the next frames."""
    problem = problem_drawn(seed)
    geometry = build_geometry(problem.matte, problem.flow, problem.validity)
    linked = geometry.link > 0
    np.testing.assert_allclose(geometry.weights[linked].sum(1), 1, rtol=1e-6)
    assert not geometry.weights[~linked].any()
    for t in range(len(problem.matte) - 1):
        start, first, last = geometry.frames[t : t + 3]
        if last - first < 2:
            continue
        for corner in (geometry.top[start:first], geometry.bottom[start:first]):
            assert np.all((corner >= first) & (corner + 1 < last))


def test_given_pixels_are_flagged():
    matte = np.ones((2, 3, 4), bool)
    fixed = np.zeros_like(matte)
    fixed[1, 2, 3] = True
    geometry = build_geometry(matte, np.zeros((1, 3, 4, 2), np.float32), np.ones((1, 3, 4), np.float32), fixed)
    np.testing.assert_array_equal(np.flatnonzero(geometry.flags & FIXED), [23])
