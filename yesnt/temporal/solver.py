"""Public functions of the temporal stage: `energy` and `solve`, for NumPy arrays and torch tensors."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.temporal.adam import solve_adam
from yesnt.temporal.geometry import Geometry, build_geometry
from yesnt.temporal.newton import Array, Limits, NewtonSolver, Outcome, Problem, State, solve_newton
from yesnt.temporal.params import EnergyParams, Solution, SolveStats

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]
Method = Literal["default", "adam"]

METHODS: dict[str, tuple[Callable[[Problem, Array, Limits], State], int]] = {
    "default": (solve_newton, 300),
    "adam": (solve_adam, 100),
}
"""Solver and limit on outer iterations by name. An outer iteration of Adam is ten steps."""


@dataclass(frozen=True)
class Inputs:
    """Checked inputs as NumPy: observed and confidence [C, T, H, W], matte [T, H, W], the geometry that they share."""

    observed: Single
    confidence: Single
    matte: Mask
    geometry: Geometry


def energy(
    x: Any, observed: Any, confidence: Any, flow: Any, validity: Any, params: EnergyParams, matte: Any = None
) -> float:
    """F(x) of docs/method.md section 4, accumulated in float64; with a channel axis, the sum over channels.

    Args:
        x: [T, H, W] or [C, T, H, W] material.
        observed: like x, the observation x~.
        confidence: like x, or [T, H, W] for all channels; data weight >= 0.
        flow: [T-1, H, W, 2] pixels (dx, dy), frame t to t+1.
        validity: [T-1, H, W] V in [0, 1] (or bool); points that leave the frame or the matte count as 0 in any case.
        params: weights of the terms.
        matte: [T, H, W] bool, or coverage (counted where > 0.5); None: all pixels.

    Raises:
        JobError: shapes disagree or a value is not finite inside the matte; the frame is named.
    """
    inputs = check_inputs(observed, confidence, flow, validity, matte)
    value = _numpy(x)
    planes = value.reshape(inputs.observed.shape)
    total = 0.0
    for channel, plane in enumerate(planes):
        _require_finite("x", plane, inputs.matte)
        problem = channel_problem(inputs, channel, params)
        total += NewtonSolver(problem).evaluate(plane[inputs.matte].astype(np.float64))
    return total


def solve(
    observed: Any,
    confidence: Any,
    flow: Any,
    validity: Any,
    params: EnergyParams,
    matte: Any = None,
    tolerance: float = 1e-4,
    method: Method = "default",
) -> Solution:
    """Minimises F; arguments as in `energy`.

    With a leading channel axis the channels share warps, validity and matte, and are solved one after the other.

    Args:
        observed: [T, H, W] or [C, T, H, W].
        confidence: like observed, or [T, H, W].
        flow: [T-1, H, W, 2].
        validity: [T-1, H, W].
        params: of the energy.
        matte: [T, H, W] or None.
        tolerance: the solver stops once (F - F*) / F* is proven to be at most this.
        method: "default", or "adam" for the paper's.

    Returns:
        The minimiser, float32, like `observed`, and what the solver did.

    Raises:
        JobError: see `energy`; or the method is unknown.
    """
    started = time.perf_counter()
    if method not in METHODS:
        raise JobError(f"unknown solver {method!r}", "method", f"one of {', '.join(METHODS)}", "choose one of these")
    inputs = check_inputs(observed, confidence, flow, validity, matte)
    solution = solve_inputs(inputs, params, tolerance, method)
    seconds = time.perf_counter() - started
    return Solution(_like(solution.value, observed), replace(solution.stats, seconds=seconds))


def solve_inputs(inputs: Inputs, params: EnergyParams, tolerance: float, method: Method = "default") -> Solution:
    """`solve` for checked inputs; the value is [C, T, H, W]."""
    started = time.perf_counter()
    run, outer = METHODS[method]
    limits = Limits(tolerance=tolerance, outer=outer)
    value, outcomes = inputs.observed.copy(), []
    for channel in range(len(value)):
        problem = channel_problem(inputs, channel, params)
        state = run(problem, problem.observed.astype(np.float64), limits)
        value[channel][inputs.matte] = state.x
        outcomes.append(state.outcome)
    return Solution(value, collect_stats(outcomes, tolerance, inputs.geometry.pixels, time.perf_counter() - started))


def collect_stats(outcomes: list[Outcome], tolerance: float, pixels: int, seconds: float) -> SolveStats:
    """Combines the channels' outcomes: sums of iterations and energy, the largest gap and step."""
    gap = max((one.gap for one in outcomes), default=0.0)
    return SolveStats(
        iterations=sum(one.outer for one in outcomes),
        inner_iterations=sum(one.inner for one in outcomes),
        seconds=seconds,
        energy=float(sum(one.energy for one in outcomes)),
        gap=gap,
        converged=gap <= tolerance,
        largest_step=max((one.step for one in outcomes), default=0.0),
        pixels=pixels,
    )


def check_inputs(
    observed: Any, confidence: Any, flow: Any, validity: Any, matte: Any, fixed: Mask | None = None
) -> Inputs:
    """Converts the arguments of `energy` to NumPy, checks them and builds the geometry.

    Raises:
        JobError: a shape is wrong, the confidence is negative, or a value inside the matte is not finite.
    """
    data = _numpy(observed)
    if data.ndim not in (3, 4) or 0 in data.shape:
        raise JobError("observed has the wrong shape", str(data.shape), "[T, H, W] or [C, T, H, W], none of them 0")
    planes = data.reshape((-1, *data.shape[-3:]))
    frames, height, width = planes.shape[1:]
    mask = np.ones((frames, height, width), bool) if matte is None else _as_mask(_numpy(matte))
    # The store may hold float16, which Numba does not index.
    weights, vectors, valid = (_numpy(a).astype(np.float32, copy=False) for a in (confidence, flow, validity))
    _require_shape("matte", mask, (frames, height, width))
    _require_shape("flow", vectors, (frames - 1, height, width, 2))
    _require_shape("validity", valid, (frames - 1, height, width))
    _require_shape("confidence", weights, (frames, height, width) if weights.ndim == 3 else planes.shape)
    weights = np.broadcast_to(weights, planes.shape)
    for plane, weight in zip(planes, weights, strict=True):
        _require_finite("observed", plane, mask)
        _require_finite("confidence", weight, mask)
    if np.any(weights[:, mask] < 0):
        raise JobError("confidence is negative", "confidence", "values in [0, 1]", "clip the confidence at 0")
    _require_finite("flow", vectors[..., 0] + vectors[..., 1], mask[:-1])
    _require_finite("validity", valid, mask[:-1])
    geometry = build_geometry(mask, vectors, valid, fixed)
    return Inputs(planes.astype(np.float32, copy=False), weights.astype(np.float32, copy=False), mask, geometry)


def channel_problem(inputs: Inputs, channel: int, params: EnergyParams) -> Problem:
    """The problem of one channel, with its matte pixels [N] as contiguous arrays."""
    observed = inputs.observed[channel][inputs.matte]
    return Problem(inputs.geometry, observed, inputs.confidence[channel][inputs.matte], params)


def _as_mask(matte: NDArray[Any]) -> Mask:
    return matte if matte.dtype == np.bool_ else matte > 0.5


def _require_shape(name: str, array: NDArray[Any], expected: tuple[int, ...]) -> None:
    if array.shape != expected:
        raise JobError(f"{name} has the wrong shape", str(array.shape), str(expected))


def _require_finite(name: str, frames: NDArray[Any], matte: Mask) -> None:
    """Refuses NaN and infinity inside the matte and names the first bad frame."""
    for t, (frame, mask) in enumerate(zip(frames, matte, strict=True)):
        bad = mask & ~np.isfinite(frame)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise JobError(
                f"{name} is not finite at {int(bad.sum())} matte pixels",
                f"frame {t} of the block, first at row {row}, column {column}",
                "finite values inside the matte",
                "redo the frame's material or flow",
            )


def _numpy(array: Any) -> NDArray[Any]:
    """NumPy view of an array or a torch tensor."""
    torch = sys.modules.get("torch")
    if torch is not None and isinstance(array, torch.Tensor):
        return array.detach().cpu().numpy()
    return np.asarray(array)


def _like(value: Single, observed: Any) -> Any:
    """`value` [C, T, H, W] in the shape and the library of `observed`."""
    torch = sys.modules.get("torch")
    value = value.reshape(tuple(observed.shape))
    if torch is not None and isinstance(observed, torch.Tensor):
        return torch.from_numpy(value).to(observed.device)
    return value
