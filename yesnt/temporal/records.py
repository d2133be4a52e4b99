"""Named tuples of arrays that the kernels of the temporal stage take as arguments.

N counts the matte pixels of all frames. `Geometry` (geometry.py) lists them by frame, row and column.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.geometry import Geometry


class Energy(NamedTuple):
    """One channel's energy F (docs/method.md section 4).

    Attributes:
        geometry: pixel lists, neighbours and links.
        observed: [N] float32, the observation x~.
        confidence: [N] float32, the data weight c >= 0.
        delta: threshold of the Huber function.
        lambda1: weight of the smoothed total variation.
        lambda2: weight of the squared residual along the flow.
        eps: smoothing of the total variation.
    """

    geometry: Geometry
    observed: NDArray[np.float32]
    confidence: NDArray[np.float32]
    delta: float
    lambda1: float
    lambda2: float
    eps: float


class Duals(NamedTuple):
    """Dual variables of the energy's terms.

    Attributes:
        qx: [N] float32, horizontal component of the spatial dual q, |q| <= 1.
        qy: [N] float32, its vertical component.
        u: [N] float32, dual of the data term, |u| <= 1.
    """

    qx: NDArray[np.float32]
    qy: NDArray[np.float32]
    u: NDArray[np.float32]


class NewtonMatrix(NamedTuple):
    """The matrix A of a Newton step, in float32 or float64.

    Attributes:
        data: [N] second derivative of the data term, >= 0.
        xx: [N] spatial term: A acts on the differences (dx, dy) of a pixel by ((xx, xy), (xy, yy)).
        xy: [N]
        yy: [N]
        coupling: weight 2 lambda2 of the links along the flow, a scalar of the same precision.
    """

    data: NDArray[Any]
    xx: NDArray[Any]
    xy: NDArray[Any]
    yy: NDArray[Any]
    coupling: Any


class ConjugateGradients(NamedTuple):
    """Vectors of preconditioned conjugate gradients for A z = -g, in the precision of A.

    Attributes:
        z: [N] solution.
        r: [N] residual -g - A z.
        p: [N] search direction.
        ap: [N] A p.
        inverse: [N] inverse diagonal of A, the preconditioner.
        frames: [T + 1] int64 as `Geometry.frames`.
        dots: [T] float64, a scalar product per frame that the last kernel computed.
    """

    z: NDArray[Any]
    r: NDArray[Any]
    p: NDArray[Any]
    ap: NDArray[Any]
    inverse: NDArray[Any]
    frames: NDArray[np.int64]
    dots: NDArray[np.float64]


class Box(NamedTuple):
    """Interval [low, high] that contains the minimiser; see certificate.py."""

    low: float
    high: float
