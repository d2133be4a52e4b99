"""Adam on float32 arrays (Kingma and Ba 2015), with a learning rate per column."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.compiled import entry
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]

BETA1, BETA2 = 0.9, 0.999
EPSILON = 1e-15
"""Smaller than torch's default of 1e-8: gradients of single Gaussians are that small."""


@entry
def adam_rows(first: Any, last: Any, values: Any, gradient: Any, moments: Any, rates: Any, corrections: Any) -> Any:
    """One step for rows [first, last) of values [N, K]; moments is the first and the second one, each [N, K]."""
    mean, square = moments
    for i in range(first, last):
        for k in range(values.shape[1]):
            g = gradient[i, k]
            mean[i, k] = BETA1 * mean[i, k] + (1 - BETA1) * g
            square[i, k] = BETA2 * square[i, k] + (1 - BETA2) * g * g
            size = math.sqrt(square[i, k] / corrections[1]) + EPSILON
            values[i, k] -= rates[k] * (mean[i, k] / corrections[0]) / size


def adam_step(values: F32, gradient: F32, moments: tuple[F32, F32], rates: NDArray[np.float64], step: int) -> None:
    """Updates values [N, ...] and moments in place; rates broadcast over the values of a row; step counts from 1."""
    n = len(values)
    flat = [a.reshape(n, -1) for a in (values, gradient, *moments)]
    corrections = (1 - BETA1**step, 1 - BETA2**step)
    columns = np.ascontiguousarray(np.broadcast_to(rates, values.shape[1:]), np.float64).reshape(-1)
    over_ranges(n, lambda a, z: adam_rows(a, z, flat[0], flat[1], (flat[2], flat[3]), columns, corrections))
