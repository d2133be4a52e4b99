"""Real spherical harmonics to degree 3 in the order, signs and scale of 3D Gaussian Splatting's files.

Source: Kerbl et al. 2023, "3D Gaussian Splatting"; the constants are those of the normalised real basis, with the
Condon-Shortley phase.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2_XY = 1.0925484305920792
C2_ZZ = 0.31539156525252005
C2_XX = 0.5462742152960396
C3_YXX = 0.5900435899266435
C3_XYZ = 2.890611442640554
C3_YZZ = 0.4570457994644658
C3_ZZZ = 0.3731763325901154
C3_ZXX = 1.445305721320277


def basis(directions: NDArray[np.floating], degree: int) -> NDArray[np.float64]:
    """Values of the (degree + 1)^2 harmonics along unit directions [..., 3]: [..., (degree + 1)^2]."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    values = [np.full_like(x, C0)]
    if degree > 0:
        values += [-C1 * y, C1 * z, -C1 * x]
    if degree > 1:
        values += [C2_XY * x * y, -C2_XY * y * z, C2_ZZ * (2 * z * z - x * x - y * y)]
        values += [-C2_XY * x * z, C2_XX * (x * x - y * y)]
    if degree > 2:
        values += [-C3_YXX * y * (3 * x * x - y * y), C3_XYZ * x * y * z, -C3_YZZ * y * (4 * z * z - x * x - y * y)]
        values += [C3_ZZZ * z * (2 * z * z - 3 * x * x - 3 * y * y), -C3_YZZ * x * (4 * z * z - x * x - y * y)]
        values += [C3_ZXX * z * (x * x - y * y), -C3_YXX * x * (x * x - 3 * y * y)]
    return np.stack(values, axis=-1)


def colors(harmonics: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.float64]:
    """Colours [N, 3] of N sets of harmonics [N, (degree + 1)^2, 3] seen along unit directions [N, 3]."""
    degree = int(np.sqrt(harmonics.shape[1])) - 1
    return np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", basis(directions, degree), harmonics))
