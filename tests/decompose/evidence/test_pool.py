import numpy as np
import pytest

from yesnt.decompose.evidence.pool import Neighbourhood, pooled, with_nearest
from yesnt.decompose.evidence.settings import EvidenceSettings

SETTINGS = EvidenceSettings()
SIDE, VIEWS = 30, 6


def plane(**changes):
    """A plane of one grey, seen by all views; the left half is likely of candidate 0, the right half of candidate 1."""
    row, column = (a.ravel().astype(np.int32) for a in np.mgrid[:SIDE, :SIDE])
    count = len(row)
    number = np.arange(count, dtype=np.int32).reshape(SIDE, SIDE)
    position = np.stack([column * 0.01, 0 * row, -row * 0.01], axis=1).astype(np.float32)
    normal = np.tile(np.float32([0, -1, 0]), (count, 1))
    right = column >= SIDE // 2
    cost = np.full((count, 4), 0.2, np.float32)
    cost[:, 0], cost[:, 1] = 0.2 * right, 0.2 * ~right
    fields = {
        "color": np.zeros((count, VIEWS, 3), np.float32), "intensity": np.zeros((count, VIEWS), np.float32),
        "valid": np.ones((count, VIEWS), np.uint8), "fitted": np.ones(count, np.uint8),
        "position": position, "normal": normal,
    } | changes  # fmt: skip
    footprint = np.full(count, 0.01, np.float32)
    nothing = np.zeros((0, 0), np.float32), np.zeros(0, np.int32)
    return Neighbourhood(row, column, number, cost, *fields.values(), footprint, *nothing), right


def leak(points, right):
    """Cost of candidate 0 that reaches the four columns on either side of the middle from the other half."""
    found = pooled(points, range(len(right)), SETTINGS)[0][:, 0].reshape(SIDE, SIDE)
    middle = SIDE // 2
    return found[:, middle - 4 : middle].mean(), points.cost.max() - found[:, middle : middle + 4].mean()


def test_a_constant_stays_constant() -> None:
    points, right = plane()
    found = pooled(points._replace(cost=np.full_like(points.cost, 0.7)), range(len(right)), SETTINGS)[0]
    np.testing.assert_allclose(found, 0.7, rtol=1e-5)


def test_equal_neighbours_are_averaged() -> None:
    left, right = (float(v) / 0.2 for v in leak(*plane()))
    assert min(left, right) > 0.25, "what looks alike everywhere is one material"


@pytest.mark.parametrize("what", ["pattern", "colour", "normal", "depth"])
def test_what_looks_otherwise_is_not_smeared(what: str) -> None:
    points, right = plane()
    names = "intensity", "color", "normal", "position"
    intensity, color, normal, position = (getattr(points, name).copy() for name in names)
    if what == "pattern":  # of one colour in the plate and in the mean, but it mirrors the light
        intensity[right, 1::2] += 1.4
        intensity[right, 2::2] -= 1.4
    elif what == "colour":
        color[right] += np.float32([0.6, 0, -0.6])
    elif what == "normal":
        normal[right] = [-1, 0, 0]
    else:
        position[right, 1] += 0.3
    spoilt = points._replace(intensity=intensity, color=color, normal=normal, position=position)
    assert max(leak(spoilt, right)) < 0.06 * spoilt.cost.max(), "the neighbour's material leaks over the border"


def test_a_point_is_pooled_with_those_that_a_camera_sees_too() -> None:
    points, right = plane()
    valid = points.valid.copy()
    valid[right] = 0
    assert leak(points._replace(valid=valid), right)[0] == 0


def test_a_range_is_a_part_of_the_whole() -> None:
    points, right = plane()
    whole, _ = pooled(points, range(len(right)), SETTINGS)
    np.testing.assert_array_equal(pooled(points, range(100, 350), SETTINGS)[0], whole[100:350])


def test_only_fitted_points_are_averaged_and_lonely_ones_are_told_apart() -> None:
    points, right = plane()
    fitted = np.zeros_like(points.fitted)
    fitted[::7] = 1
    lonely = points.color.copy()
    lonely[3] += np.float32([3, 0, -3])  # no neighbour has its colour, and it was not fitted itself
    some = points._replace(fitted=fitted, cost=np.where(fitted[:, None] == 1, 0.7, 99).astype(np.float32), color=lonely)
    found, weight = pooled(some, range(len(right)), SETTINGS)
    assert np.flatnonzero(weight == 0).tolist() == [3]
    np.testing.assert_allclose(np.delete(found, 3, axis=0), 0.7, rtol=1e-5)


def test_materials_that_look_alike_to_all_cameras_are_told_apart_by_what_they_tell() -> None:
    """Of one colour and pattern: only the disagreement of their likelihoods keeps them apart."""
    points, right = plane()
    strong = points._replace(cost=(200 * points.cost).astype(np.float32))
    top = strong.cost.max()
    assert max(leak(strong, right)) > 0.25 * top, "without it the neighbour's material leaks over the border"
    assert max(leak(with_nearest(strong, SETTINGS), right)) < 0.1 * top


def test_weak_likelihoods_that_disagree_are_averaged() -> None:
    points, right = plane()
    assert min(leak(with_nearest(points, SETTINGS), right)) > 0.25 * points.cost.max(), "one point tells too little"


def test_one_wrong_point_does_not_keep_to_itself() -> None:
    points, _ = plane()
    cost = np.full_like(points.cost, 20.0)
    cost[:, 0] = 0
    cost[435] = [20, 0, 20, 20]
    wrong = with_nearest(points._replace(cost=cost), SETTINGS)
    found = pooled(wrong, range(len(cost)), SETTINGS)[0]
    assert found[435].argmin() == 0, "its neighbours outvote it"
