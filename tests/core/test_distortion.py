"""Lens distortion against OpenCV, and its inverse."""

import cv2
import numpy as np
import pytest

from yesnt.core.distortion import Distortion

BROWN = {
    4: (-0.28, 0.07, 0.001, -0.0005),
    5: (-0.28, 0.07, 0.001, -0.0005, -0.01),
    8: (0.1, 0.2, 0.001, 0.002, 0.03, 0.2, 0.1, 0.05),
    12: (0.1, -0.2, 0.001, 0.002, 0.03, 0.2, 0.1, 0.05, 0.01, 0.002, -0.003, 0.001),
}
FISHEYE = (0.05, -0.01, 0.003, -0.001)
STRICT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)


def directions(reach):
    return np.random.default_rng(0).uniform(-reach, reach, (2, 500))


@pytest.mark.parametrize("count", BROWN)
def test_brown_is_opencvs(count):
    k, (x, y) = np.array(BROWN[count]), directions(0.6)
    lens = Distortion("brown", BROWN[count])
    ours = np.stack(lens.distort(x, y), -1)
    theirs = cv2.projectPoints(np.stack([x, y, 0 * x + 1], -1), np.zeros(3), np.zeros(3), np.eye(3), k)[0][:, 0]
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
    back = np.stack(lens.undistort(*ours.T), -1)
    np.testing.assert_allclose(back, np.stack([x, y], -1), atol=1e-12)
    undone = cv2.undistortPoints(ours[:, None], np.eye(3), k, R=np.eye(3), P=np.eye(3), criteria=STRICT)[:, 0]
    np.testing.assert_allclose(back, undone, atol=1e-10)


def test_fisheye_is_opencvs():
    x, y = directions(2.0)
    lens = Distortion("fisheye", FISHEYE)
    ours = np.stack(lens.distort(x, y), -1)
    theirs = cv2.fisheye.distortPoints(np.stack([x, y], -1)[None], np.eye(3), np.array(FISHEYE))[0]
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
    back = np.stack(lens.undistort(*ours.T), -1)
    np.testing.assert_allclose(back, np.stack([x, y], -1), atol=1e-11)
    undone = cv2.fisheye.undistortPoints(ours[None], np.eye(3), np.array(FISHEYE))[0]
    np.testing.assert_allclose(back, undone, atol=1e-9)


def test_what_the_lens_does_not_show_has_no_direction():
    """k1 = -0.3 turns back at a radius of 1.054, where it shows 0.703; a fisheye reaches 90 degrees."""
    x = np.array([0.7, 0.71, 2.0])
    found = Distortion("brown", (-0.3, 0, 0, 0)).undistort(x, 0 * x)[0]
    assert found[0] < 1.0541
    assert np.isnan(found[1:]).all()
    seen = Distortion("fisheye", (0, 0, 0, 0)).undistort(np.array([1.5, 1.6]), np.zeros(2))[0]
    assert seen[0] == pytest.approx(np.tan(1.5))
    assert np.isnan(seen[1])


def test_a_direction_that_the_lens_would_show_mirrored_is_none():
    """Tangential terms fold the picture too: with these, Newton's method ends where the mapping is turned over."""
    lens = Distortion("brown", (0.66, -0.42, -0.16, -0.32, -0.07))
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))
    u, v = lens.undistort(x, y)
    known = np.isfinite(u)
    assert 0.2 < known.mean() < 1
    step = 1e-6
    right, down = (np.stack(lens.distort(u + dx, v + dy)) for dx, dy in ((step, 0), (0, step)))
    here = np.stack([x, y])
    (xx, yx), (xy, yy) = (right - here) / step, (down - here) / step
    assert ((xx * yy - xy * yx)[known] > 0).all()


@pytest.mark.parametrize(("model", "k"), [("brown", (0.1,)), ("fisheye", (0.1,) * 5), ("none", (0.1,)),
                                          ("brown", (0.1, 0.1, 0.1, np.nan))])  # fmt: skip
def test_a_wrong_count_or_number_is_refused(model, k):
    with pytest.raises(ValueError, match=f"{len(k)} numbers: model '{model}' has"):
        Distortion(model, k)
