"""Solving a long sequence in blocks: how far a block must look, and the exchange that makes the blocks one solve.

Along a flow track the influence of a frame decays by rho per frame, rho + 1/rho = 2 + w / (2 lambda2), with w the data
weight (method.md section 4). Where the confidence is low, rho is close to 1 and no halo is long enough. Hence Schwarz's
alternating method: sweep 0 solves every block with free ends; in every later sweep a block also holds the frames just
outside its outer span, fixed to what the neighbours had in the sweep before. All blocks of one sweep are independent.

What a task loads, for a block with core [a, b) and outer span [s, e) of a sequence of T frames:

    sweep 0    observed, confidence, matte of s .. e-1; flow and validity of s .. e-2; border None
    sweep k    observed, confidence, matte and the value of sweep k-1 of s-1 .. e (where they exist);
               flow and validity of s-1 .. e-1; border = Border(value, border_mask(...))

and it stores the core's frames only. `largest_change` against sweep k-1 tells when to stop. A block may also be a band
of rows: then its border is the rows around it as far as a link reaches (`vertical_reach`).
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
"""Geometry (33) and work of a solve (56), bytes per matte pixel of its block, and what an allocator keeps beside."""

BLOCK_GAP = 1e-4
"""Certified relative gap of a block, beside the step that its caller asks for."""


@dataclass(frozen=True)
class Border:
    """What a block takes from the sweep before.

    Attributes:
        value: [T, H, W] or [C, T, H, W] the previous sweep's result on all frames of the block: fixed pixels keep it,
            the others start from it.
        fixed: [T, H, W] bool, True where the value belongs to a neighbour.
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
    """Decay of an influence from frame to frame along a track of this data weight."""
    return decay(2 * params.lambda2, confidence_floor)


def halo_frames(params: EnergyParams, confidence_floor: float, tolerance: float) -> int:
    """Frames of halo after which a change outside moves a pixel by less than `tolerance` of itself.

    Args:
        params: of the energy.
        confidence_floor: smallest data weight that may fill a track, > 0.
        tolerance: share of the change that may come through, in (0, 1).

    Raises:
        ValueError: the floor is not positive (influence reaches without limit) or the tolerance not in (0, 1).
    """
    return _reach(2 * params.lambda2, confidence_floor, tolerance)


def halo_rows(params: EnergyParams, confidence_floor: float, tolerance: float) -> int:
    """Rows of halo, as `halo_frames`: the total variation couples two rows by at most lambda1 / eps."""
    return _reach(params.lambda1 / params.eps, confidence_floor, tolerance)


def _reach(coupling: float, floor: float, tolerance: float) -> int:
    if not floor > 0:
        raise ValueError(f"confidence_floor is {floor}: expected > 0; without data no halo is long enough")
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance is {tolerance}: expected a share in (0, 1)")
    rho = decay(coupling, floor)
    return 0 if rho == 0 else math.ceil(math.log(tolerance) / math.log(rho))


def sweeps_needed(params: EnergyParams, confidence_floor: float, tolerance: float, halo: int) -> int:
    """Exchange sweeps (after sweep 0) that leave less than `tolerance`, for blocks with `halo` frames on each side.

    A fixed frame lies halo + 1 frames outside a core, and as far inside the neighbour's core, so sweep 0 leaves
    rho^(halo + 1) and each exchange takes rho^(2 halo + 2) of what is left. The figure is for tracks that are weak all
    along, hence an upper bound in practice; the job stops earlier, when a sweep changes nothing above the tolerance.
    """
    missing = halo_frames(params, confidence_floor, tolerance) - (halo + 1)
    return max(0, math.ceil(missing / (2 * halo + 2)))


def border_mask(
    shape: tuple[int, int, int], frames: tuple[int, int], rows: tuple[int, int] = (0, 0)
) -> NDArray[np.bool_]:
    """Marks the border of a block.

    Args:
        shape: (T, H, W) of the loaded block.
        frames: border frames at its start and at its end (1 where there is a neighbour, else 0).
        rows: border rows at its top and at its bottom, at least `vertical_reach` where there is a neighbour.

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
    """Rows that a band's border needs so that every link of its free pixels stays inside the loaded rows."""
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
    """One block of one sweep; arrays as in `solve`, over the frames (and rows) that the task loaded.

    Args:
        observed: [T, H, W] or [C, T, H, W].
        confidence: like observed, or [T, H, W].
        flow: [T-1, H, W, 2].
        validity: [T-1, H, W].
        params: of the energy.
        matte: [T, H, W].
        border: None in sweep 0.
        tolerance: stops once the last iteration moved no pixel by more and the certified gap is below 1e-4. The gap
            alone would allow single weak pixels to be further off than a seam may be.

    Returns:
        The block's value; border pixels as given. The caller stores the core.

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
    """A block without its empty pixels: a task that reads frame by frame never holds more.

    Attributes:
        geometry: of the N matte pixels; its fixed pixels are the border.
        observed: [C, N].
        confidence: [C, N].
        start: [C, N] the sweep before, or what was observed; fixed pixels keep it. The result takes its place, and it
            may be `observed` itself.
    """

    geometry: Geometry
    observed: Single
    confidence: Single
    start: Single


def solve_lists(
    lists: BlockLists, params: EnergyParams, tolerance: float, method: Method = "default"
) -> tuple[Single, SolveStats]:
    """One block of one sweep, as `solve_block`; returns the value [C, N], in place of the start, and the statistics."""
    started = time.perf_counter()
    outcomes = [_solve_channel(lists, channel, params, tolerance, method) for channel in range(len(lists.start))]
    return lists.start, collect_stats(outcomes, BLOCK_GAP, lists.geometry.pixels, time.perf_counter() - started)


def _solve_channel(lists: BlockLists, channel: int, params: EnergyParams, tolerance: float, method: Method) -> Outcome:
    """Solves one channel in its place; nothing of the work stays while the next one is solved."""
    run, outer = METHODS[method]
    limits = Limits(BLOCK_GAP, tolerance if method == "default" else np.inf, outer)
    # One memory layout only, because Numba compiles kernels once per layout.
    observed, confidence = (np.ascontiguousarray(array[channel]) for array in (lists.observed, lists.confidence))
    problem = Problem(lists.geometry, observed, confidence, params)
    state = run(problem, lists.start[channel].astype(np.float64), limits)
    lists.start[channel] = state.x
    return state.outcome


def block_bytes(frames: int, rows: int, width: int, matte_share: float, channels: int = 2) -> int:
    """Peak memory of `solve_lists` with its arguments and its result, bytes, without the interpreter.

    Args:
        frames: loaded frames, halo and border included.
        rows: loaded rows, halo and border included.
        width: columns.
        matte_share: share of matte pixels in what is loaded.
        channels: channels solved together.
    """
    return round(frames * rows * width * (2 + matte_share * listed_bytes(channels)))  # and two masks


def listed_bytes(channels: int = 2) -> int:
    """Memory of a solve for each pixel on its lists: geometry, work, and three values of each channel."""
    return BYTES_PER_PIXEL + 3 * 4 * channels  # observed, confidence, start


def band_rows(frames: int, width: int, matte_share: float, budget: int, channels: int = 2) -> int:
    """Rows, halo and border included, that a band of a block may load within `budget` bytes."""
    return max(1, budget // block_bytes(frames, 1, width, matte_share, channels))


def largest_change(value: NDArray[np.floating], previous: NDArray[np.floating]) -> float:
    """Largest absolute difference of two sweeps' cores; the exchange stops once it is below the asked tolerance.

    Outside the matte both hold the observation, which may be NaN there: that counts as no change.
    """
    change = np.abs(value - previous)
    return float(np.max(change, where=~np.isnan(change), initial=0.0))
