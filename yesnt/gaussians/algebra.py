"""Vectors [3] and symmetric matrices (xx, xy, xz, yy, yz, zz) as tuples inside compiled code."""

from __future__ import annotations

import math
from typing import Any

from yesnt.gaussians.compiled import kernel


@kernel
def dot(a: Any, b: Any) -> Any:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def scaled(s: Any, a: Any) -> Any:
    """The vector s a."""
    return (s * a[0], s * a[1], s * a[2])


@kernel
def added(a: Any, b: Any) -> Any:
    """The vector a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel
def times(m: Any, a: Any) -> Any:
    """The product of a symmetric matrix and a vector."""
    return (
        m[0] * a[0] + m[1] * a[1] + m[2] * a[2],
        m[1] * a[0] + m[3] * a[1] + m[4] * a[2],
        m[2] * a[0] + m[4] * a[1] + m[5] * a[2],
    )


@kernel
def outer(s: Any, a: Any, b: Any) -> Any:
    """The symmetric matrix s (a b' + b a') / 2."""
    h = 0.5 * s
    return (
        s * a[0] * b[0], h * (a[0] * b[1] + a[1] * b[0]), h * (a[0] * b[2] + a[2] * b[0]),
        s * a[1] * b[1], h * (a[1] * b[2] + a[2] * b[1]), s * a[2] * b[2],
    )  # fmt: skip


@kernel
def sum_of(m: Any, n: Any) -> Any:
    """The sum of two symmetric matrices."""
    return (m[0] + n[0], m[1] + n[1], m[2] + n[2], m[3] + n[3], m[4] + n[4], m[5] + n[5])


@kernel
def from_axes(axes: Any, values: Any) -> Any:
    """The symmetric matrix with the unit eigenvectors `axes` (three vectors) and eigenvalues `values`."""
    m = sum_of(outer(values[0], axes[0], axes[0]), outer(values[1], axes[1], axes[1]))
    return sum_of(m, outer(values[2], axes[2], axes[2]))


@kernel
def into_camera(rotation: Any, a: Any) -> Any:
    """The product of a rotation, an array [3, 3], and a vector."""
    return (
        rotation[0, 0] * a[0] + rotation[0, 1] * a[1] + rotation[0, 2] * a[2],
        rotation[1, 0] * a[0] + rotation[1, 1] * a[1] + rotation[1, 2] * a[2],
        rotation[2, 0] * a[0] + rotation[2, 1] * a[1] + rotation[2, 2] * a[2],
    )


@kernel
def into_world(rotation: Any, a: Any) -> Any:
    """The product of the inverse rotation and a vector."""
    return (
        rotation[0, 0] * a[0] + rotation[1, 0] * a[1] + rotation[2, 0] * a[2],
        rotation[0, 1] * a[0] + rotation[1, 1] * a[1] + rotation[2, 1] * a[2],
        rotation[0, 2] * a[0] + rotation[1, 2] * a[1] + rotation[2, 2] * a[2],
    )


@kernel
def normalised_quaternion(q: Any) -> Any:
    """Inverse length of a quaternion (array [4]) and its unit components w, x, y, z."""
    inverse = 1 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return inverse, q[0] * inverse, q[1] * inverse, q[2] * inverse, q[3] * inverse


@kernel
def quaternion_axes(w: Any, x: Any, y: Any, z: Any) -> Any:
    """The three columns of the rotation matrix of a unit quaternion."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@kernel
def quaternion_gradient(q: Any, a: Any, b: Any, c: Any) -> Any:
    """Gradient of a quaternion (array [4]) from those of the columns a, b, c of its rotation matrix."""
    inverse, w, x, y, z = normalised_quaternion(q)
    gw = 2 * (z * (a[1] - b[0]) + y * (c[0] - a[2]) + x * (b[2] - c[1]))
    gx = 2 * (y * (a[1] + b[0]) + z * (a[2] + c[0]) - 2 * x * (b[1] + c[2]) + w * (b[2] - c[1]))
    gy = 2 * (x * (a[1] + b[0]) + z * (b[2] + c[1]) - 2 * y * (a[0] + c[2]) + w * (c[0] - a[2]))
    gz = 2 * (x * (a[2] + c[0]) + y * (b[2] + c[1]) - 2 * z * (a[0] + b[1]) + w * (a[1] - b[0]))
    along = w * gw + x * gx + y * gy + z * gz  # the length of a quaternion has no effect
    return (
        (gw - w * along) * inverse, (gx - x * along) * inverse,
        (gy - y * along) * inverse, (gz - z * along) * inverse,
    )  # fmt: skip
