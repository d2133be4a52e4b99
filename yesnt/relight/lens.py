"""Projection through a lens in compiled kernels: the float32 twin of core/distortion.py."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera, lens_reach
from yesnt.core.camera_document import Lens
from yesnt.relight.compiled import exact_kernel

F32 = NDArray[np.float32]

PINHOLE, BROWN, FISHEYE = 0, 1, 2
"""Models of a `LensRecord`."""

_CODES = {"brown": BROWN, "fisheye": FISHEYE}


class LensRecord(NamedTuple):
    """A camera's intrinsics and distortion, pixels.

    Attributes:
        fx, fy: focal lengths.
        cx, cy: principal point.
        model: PINHOLE, BROWN or FISHEYE.
        k: [12] OpenCV's coefficients, filled up with 0.
        reach: largest distance from the axis on the plane z = 1 that the picture shows; farther out a polynomial may
            fold back into the picture.
    """

    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32
    model: int
    k: F32
    reach: np.float32


SQUARE = 0.01
"""Relative difference of fx and fy up to which pixels count as square: calibrations differ by less."""


def pixel_focal(lens: Lens) -> float:
    """Focal length in pixels along the longer side of a pixel: depth over it is what a pixel covers."""
    return lens.fx if abs(lens.fx - lens.fy) <= SQUARE * lens.fy else min(lens.fx, lens.fy)


class PlanePoint(NamedTuple):
    """A point on the plane z = 1."""

    x: np.float32
    y: np.float32


def lens_record(camera: Camera, frame: int | None) -> LensRecord:
    """The lens of a frame as kernels read it; frame None: the first."""
    lens = camera.lens(frame)
    fx, fy, cx, cy = (np.float32(value) for value in (lens.fx, lens.fy, lens.cx, lens.cy))
    k = np.array(lens.distortion.coefficients, np.float32)
    if not lens.distortion.acts:
        return LensRecord(fx, fy, cx, cy, PINHOLE, k, np.float32(np.inf))
    reach = lens_reach(lens, (camera.width, camera.height))
    return LensRecord(fx, fy, cx, cy, _CODES[lens.distortion.model], k, np.float32(reach))


@exact_kernel
def distorted(x, y, lens):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Where a lens that is no pinhole shows the direction (x, y, 1), on the plane z = 1."""
    one, two, r2, k = np.float32(1), np.float32(2), x * x + y * y, lens.k
    if lens.model == FISHEYE:
        radius = np.sqrt(r2)
        if radius < np.float32(1e-6):
            return PlanePoint(x, y)
        theta = np.arctan(radius)
        t2 = theta * theta
        ratio = theta * (one + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / radius
        return PlanePoint(x * ratio, y * ratio)
    radial = (one + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (one + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    across = x * radial + two * k[2] * x * y + k[3] * (r2 + two * x * x) + r2 * (k[8] + k[9] * r2)
    down = y * radial + k[2] * (r2 + two * y * y) + two * k[3] * x * y + r2 * (k[10] + k[11] * r2)
    return PlanePoint(across, down)
