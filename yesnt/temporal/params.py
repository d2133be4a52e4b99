"""Records of the temporal stage: the energy's parameters, what a solver reports, what it returns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class EnergyParams:
    """Parameters of the energy of method.md section 4. The paper gives no values; these were chosen on data.

    The sweep is tests/benchmarks/temporal_lambdas.py, its figures are in docs/temporal.md.

    Attributes:
        delta: Huber's threshold: residuals above it are taken for outliers. Unit of the material, > 0.
        lambda1: weight of the smoothed total variation in space, >= 0.
        lambda2: weight of the squared difference along the flow, >= 0.
        eps: rounding of the total variation at 0, > 0 (it makes the energy smooth). Unit of the material per pixel.

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
    """What one solve did; sums (seconds, iterations) and the worst (gap) over the channels.

    Attributes:
        iterations: outer iterations.
        inner_iterations: products with the linear operator (0 for Adam).
        seconds: wall time, the geometry included.
        energy: F of the returned value, summed over channels.
        gap: upper bound on (F - F*) / F*; see certificate.py.
        converged: gap <= tolerance.
        largest_step: largest change of a pixel in the last iteration.
        pixels: matte pixels of all frames that were solved for, per channel.
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
            is what was observed.
        stats: what the solver did.
    """

    value: Any
    stats: SolveStats
