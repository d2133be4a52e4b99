from itertools import pairwise

import numpy as np
import pytest

from yesnt.decompose.blend import PatchGrid, PatchSum, raised_cosine, unit_windows


@pytest.mark.parametrize("seed", range(20))
def test_windows_sum_to_one_everywhere(seed):
    rng = np.random.default_rng(seed)
    height, width, size, overlap = *rng.integers(5, 150, 2), rng.integers(8, 48), rng.uniform(0, 0.9)
    grid = PatchGrid.cover(height, width, size, overlap)
    total = np.zeros((grid.height, grid.width))
    for patch in grid.patches:
        grid.crop(total, patch)[...] += grid.window(patch)
    np.testing.assert_allclose(total, 1, atol=1e-6)


@pytest.mark.parametrize("length", [96, 100, 129, 384, 1000])
def test_aligned_grids_cover_and_stay_aligned(length):
    grid = PatchGrid.cover(length, 96, 96, 0.25, align=8)
    tops = sorted({patch.top for patch in grid.patches})
    assert all(top % 8 == 0 for top in tops)
    assert length <= grid.height < length + 96
    assert all(b - a <= 72 for a, b in pairwise(tops))
    assert tops[-1] + 96 == grid.height


def test_an_overlap_between_two_aligned_ones_is_rounded_up():
    tops = sorted({patch.top for patch in PatchGrid.cover(1000, 96, 96, 0.3, align=8).patches})
    assert max(b - a for a, b in pairwise(tops)) <= 96 - 0.3 * 96


def test_patch_must_be_aligned():
    with pytest.raises(ValueError, match="multiple of 8"):
        PatchGrid.cover(100, 100, 90, 0.25, align=8)


def test_constant_field_stays_constant_to_1e_6():
    grid = PatchGrid.cover(100, 131, 32, 0.25)
    blended = PatchSum(grid, 2)
    for patch in grid.patches:
        blended.add(patch, np.full((2, 32, 32), 0.7371, np.float32))
    np.testing.assert_allclose(blended.value(), 0.7371, atol=1e-6)


def test_order_of_patches_does_not_change_a_bit():
    rng = np.random.default_rng(0)
    grid = PatchGrid.cover(90, 70, 24, 0.4)
    values = rng.random((len(grid.patches), 2, 24, 24), dtype=np.float32)
    results = []
    for order in (range(len(values)), rng.permutation(len(values)), rng.permutation(len(values))):
        blended = PatchSum(grid, 2)
        for k in order:
            blended.add(grid.patches[k], values[k])
        results.append(blended.value().tobytes())
    assert len(set(results)) == 1


def test_windows_fall_smoothly_between_neighbours():
    windows = unit_windows((0, 16), 32, 48)
    across = windows[0, 16:]
    assert across[0] > 0.99
    assert across[-1] < 0.01
    assert (np.diff(across) < 0).all()
    np.testing.assert_allclose(across, windows[1, :16][::-1], atol=1e-12)


def test_raised_cosine_is_symmetric_and_never_zero():
    window = raised_cosine(33)
    np.testing.assert_allclose(window, window[::-1])
    assert window.min() > 0


def test_patches_without_matte_are_skipped_and_matte_stays_covered():
    grid = PatchGrid.cover(128, 128, 32, 0.25)
    matte = np.zeros((128, 128), np.float32)
    matte[3:20, 90:97] = 1
    kept = grid.covering(matte)
    assert 0 < len(kept) < len(grid.patches) / 3
    total = np.zeros_like(matte)
    for patch in kept:
        grid.crop(total, patch)[...] += grid.window(patch)
    np.testing.assert_allclose(total[matte > 0], 1, atol=1e-6)


def test_overlap_must_leave_room_to_advance():
    with pytest.raises(ValueError, match="overlap"):
        PatchGrid.cover(100, 100, 32, 1.0)
