"""Solves a long sequence in blocks and exchanges their borders until the blocks agree with one solve of the whole.

Along a flow track the influence of a frame decays by rho per frame, rho + 1/rho = 2 + w / (2 lambda2), with w the data
weight (docs/method.md section 4). Where the confidence is low, rho is close to 1 and no halo is long enough. Hence
Schwarz's alternating method: sweep 0 solves every block with free ends. In every later sweep a block also contains the
frames just outside its outer span, fixed to their values of the previous sweep. Blocks of one sweep are independent.

A task loads, for a block with core [a, b) and outer span [s, e) of a sequence of T frames:

    sweep 0    observed, confidence, matte of s .. e-1; flow and validity of s .. e-2; border None
    sweep k    observed, confidence, matte and the value of sweep k-1 of s-1 .. e (where they exist);
               flow and validity of s-1 .. e-1; border = Border(value, border_mask(...))

It stores the frames of the core. `largest_change` against sweep k-1 tells when to stop. A block may also be a band of
rows; its border is then the rows around it that a link can reach (`vertical_reach`).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal.geometry import Geometry
from yesnt.temporal.newton import Limits, Outcome, Problem
from yesnt.temporal.params import EnergyParams, Solution, SolveStats
from yesnt.temporal.solver import METHODS, Method, check_inputs, collect_stats

Single = NDArray[np.float32]

BYTES_PER_PIXEL = 95
"""Bytes per matte pixel: geometry (33), work arrays of a solve (56), overhead of the allocator (6)."""

BLOCK_GAP = 1e-4
"""Relative gap to which a block is solved, in addition to the step size that its caller asks for."""


@dataclass(frozen=True)
class Border:
    """What a block takes from the previous sweep.

    Attributes:
        value: [T, H, W] or [C, T, H, W], result of the previous sweep on all frames of the block. Fixed pixels keep it,
            the others start from it.
        fixed: [T, H, W] bool, True where the pixel belongs to a neighbouring block.
    """

    value: NDArray[np.float32]
    fixed: NDArray[np.bool_]


def decay(coupling: float, weight: float) -> float:
    """The root rho in [0, 1] of rho + 1/rho = 2 + weight / coupling; 0 without coupling, 1 without data."""
    if coupling == 0:
        return 0.0
    half = 1 + 0.5 * weight / coupling
    return 1.0 / (half + math.sqrt(half * half - 1))  # not half - sqrt(..): that cancels for large ratios


def decay_per_frame(params: EnergyParams, confidence_floor: float) -> float:
    """Decay rho of an influence per frame along a track of this data weight."""
    return decay(2 * params.lambda2, confidence_floor)


def halo_frames(params: EnergyParams, confidence_floor: float, tolerance: float) -> int:
    """Frames of halo that reduce the effect of a change outside to less than `tolerance` of it.

    Args:
        params: weights of the terms.
        confidence_floor: smallest data weight along a whole track, > 0.
        tolerance: remaining share of the change, in (0, 1).

    Raises:
        ValueError: the floor is not positive (the reach is infinite), or the tolerance is not in (0, 1).
    """
    return _reach(2 * params.lambda2, confidence_floor, tolerance)


def halo_rows(params: EnergyParams, confidence_floor: float, tolerance: float) -> int:
    """Rows of halo, computed like `halo_frames`; the total variation couples rows by at most lambda1 / eps."""
    return _reach(params.lambda1 / params.eps, confidence_floor, tolerance)


def _reach(coupling: float, floor: float, tolerance: float) -> int:
    if not floor > 0:
        raise ValueError(f"confidence_floor is {floor}: expected > 0; without data no halo is long enough")
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is {tolerance}: expected a share in (0, 1)")
    rho = decay(coupling, floor)
    return 0 if rho == 0 else math.ceil(math.log(tolerance) / math.log(rho))


def sweeps_needed(params: EnergyParams, confidence_floor: float, tolerance: float, halo: int) -> int:
    """Exchange sweeps after sweep 0 that leave an error below `tolerance`, with `halo` frames on each side of a core.

    A fixed frame lies halo + 1 frames outside a core, and as far inside the neighbour's core: sweep 0 leaves an error
    of rho^(halo + 1), and each exchange multiplies it by rho^(2 halo + 2). This holds for tracks of low data weight
    throughout and is an upper bound otherwise; a job stops once a sweep changes nothing above the tolerance.
    """
    missing = halo_frames(params, confidence_floor, tolerance) - (halo + 1)
    return max(0, math.ceil(missing / (2 * halo + 2)))


def border_mask(
    shape: tuple[int, int, int], frames: tuple[int, int], rows: tuple[int, int] = (0, 0)
) -> NDArray[np.bool_]:
    """Marks the border pixels of a block.

    Args:
        shape: (T, H, W) of the loaded block.
        frames: number of border frames at the start and the end (1 if there is a neighbour, else 0).
        rows: number of border rows at the top and the bottom; at least `vertical_reach` if there is a neighbour.

    Returns:
        [T, H, W] bool for `Border.fixed`.
    """
    fixed = np.zeros(shape, bool)
    fixed[: frames[0]] = True
    fixed[shape[0] - frames[1] :] = True
    fixed[:, : rows[0]] = True
    fixed[:, shape[1] - rows[1] :] = True
    return fixed


def vertical_reach(flow: NDArray[np.floating], validity: NDArray[Any]) -> int:
    """Number of border rows with which every link of a band's free pixels stays inside the loaded rows."""
    return math.ceil(float(np.max(np.abs(flow[..., 1]) * (validity > 0), initial=0.0))) + 1


def solve_block(
    observed: Any,
    confidence: Any,
    flow: Any,
    validity: Any,
    params: EnergyParams,
    matte: Any,
    border: Border | None = None,
    tolerance: float = 1e-5,
) -> Solution:
    """Solves one block in one sweep; arrays as in `solve`, over the frames and rows that the task loaded.

    Args:
        observed: [T, H, W] or [C, T, H, W].
        confidence: like observed, or [T, H, W].
        flow: [T-1, H, W, 2].
        validity: [T-1, H, W].
        params: of the energy.
        matte: [T, H, W].
        border: None in sweep 0.
        tolerance: the solver stops once the last iteration moved no pixel by more than this and the certified gap is
            below 1e-4. The gap alone would allow larger errors at single pixels of low confidence.

    Returns:
        The block's value, with border pixels as given, and statistics. The caller stores the core.

    Raises:
        JobError: as `solve`.
    """
    started = time.perf_counter()
    fixed = None if border is None else border.fixed
    inputs = check_inputs(observed, confidence, flow, validity, matte, fixed)
    start = inputs.observed if border is None else np.asarray(border.value, np.float32).reshape(inputs.observed.shape)
    lists = BlockLists(inputs.geometry, *(a[:, inputs.matte] for a in (inputs.observed, inputs.confidence, start)))
    value = start.copy()
    value[:, inputs.matte], stats = solve_lists(lists, params, tolerance)
    stats = replace(stats, seconds=time.perf_counter() - started)
    return Solution(value.reshape(np.shape(observed)), stats)


@dataclass(frozen=True)
class BlockLists:
    """The matte pixels of a block; a task that reads frame by frame holds nothing else.

    Attributes:
        geometry: lists of the N matte pixels; its fixed pixels are the border.
        observed: [C, N].
        confidence: [C, N].
        start: [C, N], value of the previous sweep, or the observed one; fixed pixels keep it. It is overwritten by the
            result and may be `observed` itself.
    """

    geometry: Geometry
    observed: Single
    confidence: Single
    start: Single


def solve_lists(
    lists: BlockLists, params: EnergyParams, tolerance: float, method: Method = "default"
) -> tuple[Single, SolveStats]:
    """Solves one block, as `solve_block`; returns the value [C, N], stored in `lists.start`, and statistics."""
    started = time.perf_counter()
    outcomes = [_solve_channel(lists, channel, params, tolerance, method) for channel in range(len(lists.start))]
    return lists.start, collect_stats(outcomes, BLOCK_GAP, lists.geometry.pixels, time.perf_counter() - started)


def _solve_channel(lists: BlockLists, channel: int, params: EnergyParams, tolerance: float, method: Method) -> Outcome:
    """Solves one channel in place; its work arrays are freed before the next one is solved."""
    run, outer = METHODS[method]
    limits = Limits(BLOCK_GAP, tolerance if method == "default" else np.inf, outer)
    # One memory layout only, because Numba compiles kernels once per layout.
    observed, confidence = (np.ascontiguousarray(array[channel]) for array in (lists.observed, lists.confidence))
    problem = Problem(lists.geometry, observed, confidence, params)
    state = run(problem, lists.start[channel].astype(np.float64), limits)
    lists.start[channel] = state.x
    return state.outcome


def block_bytes(frames: int, rows: int, width: int, matte_share: float, channels: int = 2) -> int:
    """Peak memory of `solve_lists` in bytes, including its arguments and its result, without the interpreter.

    Args:
        frames: number of loaded frames, including halo and border.
        rows: number of loaded rows, including halo and border.
        width: columns.
        matte_share: share of matte pixels among the loaded ones.
        channels: number of channels.
    """
    return round(frames * rows * width * (2 + matte_share * listed_bytes(channels)))  # and two masks


def listed_bytes(channels: int = 2) -> int:
    """Bytes of a solve per matte pixel: geometry, work arrays, and three values per channel."""
    return BYTES_PER_PIXEL + 3 * 4 * channels  # observed, confidence, start


def band_rows(frames: int, width: int, matte_share: float, budget: int, channels: int = 2) -> int:
    """Number of rows, including halo and border, that a band may load within `budget` bytes; at least 1."""
    return max(1, budget // block_bytes(frames, 1, width, matte_share, channels))


def largest_change(value: NDArray[np.floating], previous: NDArray[np.floating]) -> float:
    """Largest absolute difference of two sweeps' cores; the exchange stops once it is below the tolerance.

    Outside the matte both hold the observed value. It may be NaN there, which counts as no change.
    """
    change = np.abs(value - previous)
    return float(np.max(change, where=~np.isnan(change), initial=0.0))
