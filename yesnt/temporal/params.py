"""Public records of the temporal stage: parameters of the energy, statistics and result of a solve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class EnergyParams:
    """Parameters of the energy of docs/method.md section 4. The paper gives no values; these were chosen on data.

    tests/benchmarks/temporal_lambdas.py compares values; docs/temporal.md has the figures.

    Attributes:
        delta: threshold of the Huber function, above which residuals count as outliers. Unit of the material, > 0.
        lambda1: weight of the smoothed total variation in space, >= 0.
        lambda2: weight of the squared difference along the flow, >= 0.
        eps: smoothing of the total variation at 0, > 0. Unit of the material per pixel.

    Raises:
        ValueError: a value is not finite or out of range.
    """

    delta: float = 0.1
    lambda1: float = 0.04
    lambda2: float = 1.0
    eps: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("delta", "lambda1", "lambda2", "eps"):
            value = getattr(self, name)
            positive = name in ("delta", "eps")
            if not math.isfinite(value) or value < 0 or (positive and value == 0):
                raise ValueError(
                    f"EnergyParams.{name} is {value}: expected a finite number {'>' if positive else '>='} 0"
                )


@dataclass(frozen=True)
class SolveStats:
    """Statistics of a solve: sums over the channels (seconds, iterations, energy) or the largest (gap, step).

    Attributes:
        iterations: outer iterations.
        inner_iterations: products with the linear operator (0 for Adam).
        seconds: wall time, including the construction of the geometry.
        energy: F of the returned value, summed over channels.
        gap: upper bound on (F - F*) / F*; see certificate.py.
        converged: gap <= tolerance.
        largest_step: largest change of a pixel in the last iteration.
        pixels: number of matte pixels in all frames.
    """

    iterations: int
    inner_iterations: int
    seconds: float
    energy: float
    gap: float
    converged: bool
    largest_step: float
    pixels: int


@dataclass(frozen=True)
class Solution:
    """A regularised material.

    Attributes:
        value: like `observed`: same shape, NumPy float32 or a torch tensor on the input's device. Outside the matte it
            equals `observed`.
        stats: statistics of the solve.
    """

    value: Any
    stats: SolveStats
