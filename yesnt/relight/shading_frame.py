"""Local frame of a shaded pixel: normal, tangent in the plane of the view, bitangent."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from yesnt.relight.brdf import COS_MIN
from yesnt.relight.compiled import inlined, kernel

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)

FRAME_SIZE = 12
"""Numbers of a stored frame, in the order of the fields of `ShadingFrame`."""


class Vector(NamedTuple):
    """A vector in world axes, float32."""

    x: np.float32
    y: np.float32
    z: np.float32


class ShadingFrame(NamedTuple):
    """Orthonormal frame of one pixel, with the view in the plane of normal and tangent.

    Attributes:
        normal: n, unit, world.
        tangent: t, unit, world, along the part of the view v that is perpendicular to n.
        bitangent: b = n x t.
        cos_o: n.v, clamped to [COS_MIN, 1].
        sin_o: t.v = sqrt(1 - cos_o^2).
        alpha: alpha_ggx.
    """

    normal: Vector
    tangent: Vector
    bitangent: Vector
    cos_o: np.float32
    sin_o: np.float32
    alpha: np.float32


@inlined
def dot(a, b):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Scalar product of two vectors."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@kernel
def store_frame(normal, view, alpha, stored):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Writes the ShadingFrame of a pixel to `stored` [12] float32.

    Args:
        normal: Vector, unit, world.
        view: Vector, unit, world, towards the camera; one behind the normal is bent to just above the horizon.
        alpha: alpha_ggx.
        stored: [12] float32.
    """
    nx, ny, nz = normal.x, normal.y, normal.z
    cosine = nx * view.x + ny * view.y + nz * view.z
    tx, ty, tz = view.x - cosine * nx, view.y - cosine * ny, view.z - cosine * nz
    length = math.sqrt(tx * tx + ty * ty + tz * tz)
    if length < np.float32(1e-6):  # looking along the normal: any tangent will do
        if abs(nx) < np.float32(0.7):
            tx, ty, tz = _ONE - nx * nx, -nx * ny, -nx * nz
        else:
            tx, ty, tz = -ny * nx, _ONE - ny * ny, -ny * nz
        length = math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / length, ty / length, tz / length
    cos_o = min(max(cosine, np.float32(COS_MIN)), _ONE)
    stored[0], stored[1], stored[2] = nx, ny, nz
    stored[3], stored[4], stored[5] = tx, ty, tz
    stored[6], stored[7], stored[8] = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    stored[9], stored[10], stored[11] = cos_o, math.sqrt(max(_ONE - cos_o * cos_o, _ZERO)), alpha


@inlined
def load_frame(stored):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """ShadingFrame of `stored` [12] float32: numbers that stay in registers during a loop."""
    normal = Vector(stored[0], stored[1], stored[2])
    tangent = Vector(stored[3], stored[4], stored[5])
    bitangent = Vector(stored[6], stored[7], stored[8])
    return ShadingFrame(normal, tangent, bitangent, stored[9], stored[10], stored[11])
