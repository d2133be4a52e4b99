"""Lens distortion on the plane z = 1 of a camera: OpenCV's polynomial ("Brown") and fisheye models and their inverse.

Source: OpenCV, "Camera Calibration and 3D Reconstruction"; Brown 1971, "Close-range camera calibration"; Kannala and
Brandt 2006 for the fisheye.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Model = Literal["none", "brown", "fisheye"]

BROWN_COUNTS = (4, 5, 8, 12)
"""Numbers that a Brown model may have: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]."""

FISHEYE_COUNT = 4

_STEPS = 25
_PRECISION = 1e-10  # on the plane z = 1: 1e-6 pixel at a focal length of 10,000 pixels
_BISECTIONS = 40


@dataclass(frozen=True)
class Distortion:
    """A lens model; `k` in OpenCV's order.

    Attributes:
        model: "none", "brown" (OpenCV's default, rational and thin prism terms included) or "fisheye".
        k: brown: 4, 5, 8 or 12 numbers; fisheye: 4; none: no number.

    Raises:
        ValueError: another count, or a number that is not finite.
    """

    model: Model = "none"
    k: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        counts = {"none": (0,), "brown": BROWN_COUNTS, "fisheye": (FISHEYE_COUNT,)}[self.model]
        if len(self.k) not in counts or not np.isfinite(self.k).all():
            raise ValueError(
                f"{len(self.k)} numbers: model {self.model!r} has {' or '.join(map(str, counts))} finite numbers"
            )

    @property
    def acts(self) -> bool:
        """Whether the lens bends any ray; a fisheye without coefficients is equidistant and does."""
        return self.model == "fisheye" or (self.model == "brown" and any(self.k))

    @property
    def coefficients(self) -> tuple[float, ...]:
        """`k` filled up to 12 numbers with 0."""
        return (*self.k, *(0.0,) * (12 - len(self.k)))

    def distort(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Where the lens shows the directions (x, y, 1): distorted x and y of the same shape."""
        if not self.acts:
            return x, y
        if self.model == "fisheye":
            radius = np.hypot(x, y)
            ratio = _ratio(_fisheye(np.arctan(radius), self.k)[0], radius)
            return x * ratio, y * ratio
        bent, _ = _brown(x, y, self.coefficients)
        return bent

    def undistort(self, x: F64, y: F64) -> tuple[F64, F64]:
        """The directions (x, y, 1) that the lens shows at distorted x and y; NaN where there is none in front of it.

        Newton's method. Only the branch that holds the optical axis is inverted: beyond the radius where the radial
        polynomial turns back, a polynomial shows the world mirrored and a lens shows nothing.
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if not self.acts:
            return x, y
        if self.model == "fisheye":
            return self._undistort_fisheye(x, y)
        return self._undistort_brown(x, y)

    def _undistort_fisheye(self, x: F64, y: F64) -> tuple[F64, F64]:
        target = np.hypot(x, y)
        most = _first_turn(lambda theta: _fisheye(theta, self.k)[1], np.pi / 2)
        theta = np.minimum(target, most)
        for _ in range(_STEPS):
            value, slope = _fisheye(theta, self.k)
            step = (value - target) / np.where(np.abs(slope) > 1e-12, slope, 1e-12)
            theta = np.clip(theta - step, 0, most)
        bad = (np.abs(_fisheye(theta, self.k)[0] - target) > _PRECISION) | (theta >= np.pi / 2 - 1e-6)
        ratio = np.where(bad, np.nan, _ratio(np.tan(np.where(bad, 0, theta)), target))
        return x * ratio, y * ratio

    def _undistort_brown(self, x: F64, y: F64) -> tuple[F64, F64]:
        k = self.coefficients
        most = _first_turn(lambda radius: _radial_slope(radius, k), 1e3)
        u, v = _within(x, y, 0.999 * most)
        for _ in range(_STEPS):
            (bent_x, bent_y), (xx, xy, yx, yy) = _brown(u, v, k)
            off_x, off_y = bent_x - x, bent_y - y
            if np.max(np.hypot(off_x, off_y), initial=0.0) < 0.01 * _PRECISION:
                break
            det = xx * yy - xy * yx
            det = np.where(np.abs(det) > 1e-12, det, 1e-12)
            u, v = _within(u - (yy * off_x - xy * off_y) / det, v - (xx * off_y - yx * off_x) / det, most)
        (bent_x, bent_y), (xx, xy, yx, yy) = _brown(u, v, k)
        bad = ~(np.hypot(bent_x - x, bent_y - y) < _PRECISION) | (xx * yy - xy * yx <= 0)
        return np.where(bad, np.nan, u), np.where(bad, np.nan, v)


UNDISTORTED = Distortion()
"""A lens that bends nothing."""


def _ratio(bent: F64, radius: F64) -> F64:
    """Ratio bent / radius, 1 on the optical axis."""
    small = radius < 1e-12
    return np.where(small, 1.0, bent / np.where(small, 1.0, radius))


def _within(x: F64, y: F64, most: float) -> tuple[F64, F64]:
    """Points [...] moved towards the axis where their radius exceeds `most`."""
    scale = np.minimum(1, most / np.maximum(np.hypot(x, y), 1e-300))
    return x * scale, y * scale


def _fisheye(theta: F64, k: tuple[float, ...]) -> tuple[F64, F64]:
    """Distorted angle theta_d and its derivative by theta."""
    square = theta * theta
    value, slope = np.zeros_like(theta), np.zeros_like(theta)
    for power, factor in zip((8, 6, 4, 2), reversed(k), strict=True):
        value, slope = (value + factor) * square, (slope + (power + 1) * factor) * square
    return theta * (1 + value), 1 + slope


def _brown(x: F64, y: F64, k: tuple[float, ...]) -> tuple[tuple[F64, F64], tuple[F64, F64, F64, F64]]:
    """Distorted x and y, and the derivatives dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
    _, _, p1, p2, _, _, _, _, s1, s2, s3, s4 = k
    r2 = x * x + y * y
    radial, slope = _radial(r2, k)
    prism_x, prism_y = s1 + 2 * s2 * r2, s3 + 2 * s4 * r2
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + s2 * r2)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + s4 * r2)
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + 2 * x * prism_x
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + 2 * y * prism_y
    return (bent_x, bent_y), (xx, cross + 2 * y * prism_x, cross + 2 * x * prism_y, yy)


def _radial(r2: F64, k: tuple[float, ...]) -> tuple[F64, F64]:
    """Rational radial factor at squared radius `r2` and its derivative by it."""
    k1, k2, _, _, k3, k4, k5, k6, *_ = k
    above, below = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    d_above, d_below = k1 + r2 * (2 * k2 + 3 * k3 * r2), k4 + r2 * (2 * k5 + 3 * k6 * r2)
    return above / below, (d_above * below - above * d_below) / (below * below)


def _radial_slope(radius: F64, k: tuple[float, ...]) -> F64:
    """Derivative of radius times radial factor."""
    factor, slope = _radial(radius * radius, k)
    return factor + 2 * radius * radius * slope


def _first_turn(slope: Callable[[F64], F64], end: float) -> float:
    """Smallest argument in (0, end] at which a slope is no longer positive; `end` if there is none."""
    grid = np.concatenate([np.linspace(0, min(end, 4), 4001), np.geomspace(4, end, 1000) if end > 4 else np.zeros(0)])
    turned = np.flatnonzero(~(slope(grid) > 0))
    if not len(turned) or turned[0] == 0:
        return end
    low, high = float(grid[turned[0] - 1]), float(grid[turned[0]])
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(np.asarray(middle)) > 0 else (low, middle)
    return low
