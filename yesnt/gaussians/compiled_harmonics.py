"""Colours by direction and their gradients, one Gaussian at a time (harmonics.py is the reference)."""

from __future__ import annotations

from typing import Any

from yesnt.gaussians.compiled import kernel
from yesnt.gaussians.harmonics import C0, C1, C2_XX, C2_XY, C2_ZZ, C3_XYZ, C3_YXX, C3_YZZ, C3_ZXX, C3_ZZZ


@kernel
def fill_basis(count: Any, d: Any, out: Any) -> Any:
    """Writes the first `count` (1, 4, 9 or 16) harmonics along the unit vector d to out [16]."""
    x, y, z = d
    xx, yy, zz = x * x, y * y, z * z
    out[0] = C0
    if count > 1:
        out[1], out[2], out[3] = -C1 * y, C1 * z, -C1 * x
    if count > 4:
        out[4], out[5], out[6] = C2_XY * x * y, -C2_XY * y * z, C2_ZZ * (2 * zz - xx - yy)
        out[7], out[8] = -C2_XY * x * z, C2_XX * (xx - yy)
    if count > 9:
        out[9], out[10] = -C3_YXX * y * (3 * xx - yy), C3_XYZ * x * y * z
        out[11], out[12] = -C3_YZZ * y * (4 * zz - xx - yy), C3_ZZZ * z * (2 * zz - 3 * xx - 3 * yy)
        out[13], out[14] = -C3_YZZ * x * (4 * zz - xx - yy), C3_ZXX * z * (xx - yy)
        out[15] = -C3_YXX * x * (xx - 3 * yy)


@kernel
def direction_gradient(count: Any, d: Any, g: Any) -> Any:
    """Gradient of sum_k g[k] basis_k(d) by d, with basis_k as polynomials of free x, y, z."""
    x, y, z = d
    xx, yy, zz = x * x, y * y, z * z
    gx, gy, gz = 0.0, 0.0, 0.0
    if count > 1:
        gx, gy, gz = -C1 * g[3], -C1 * g[1], C1 * g[2]
    if count > 4:
        gx += C2_XY * (y * g[4] - z * g[7]) + 2 * x * (C2_XX * g[8] - C2_ZZ * g[6])
        gy += C2_XY * (x * g[4] - z * g[5]) - 2 * y * (C2_XX * g[8] + C2_ZZ * g[6])
        gz += -C2_XY * (y * g[5] + x * g[7]) + 4 * C2_ZZ * z * g[6]
    if count > 9:
        a, b, e, f = C3_YXX * g[9], C3_XYZ * g[10], C3_YZZ * g[11], C3_ZZZ * g[12]
        h, j, k = C3_YZZ * g[13], C3_ZXX * g[14], C3_YXX * g[15]
        gx += -6 * a * x * y + b * y * z + 2 * e * x * y - 6 * f * x * z - h * (4 * zz - 3 * xx - yy)
        gx += 2 * j * x * z - 3 * k * (xx - yy)
        gy += -3 * a * (xx - yy) + b * x * z - e * (4 * zz - xx - 3 * yy) - 6 * f * y * z + 2 * h * x * y
        gy += -2 * j * y * z + 6 * k * x * y
        gz += b * x * y - 8 * e * y * z + f * (6 * zz - 3 * xx - 3 * yy) - 8 * h * x * z + j * (xx - yy)
    return gx, gy, gz
