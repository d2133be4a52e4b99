"""Divides a shot for the temporal solver: chunks of frames with a halo, bands of rows, number of exchange sweeps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from yesnt.core.blocks import Block, row_bands
from yesnt.core.shot import Job, TemporalInput
from yesnt.io.shot_inputs import read_matte
from yesnt.temporal.blocks import band_rows, block_bytes, halo_frames, halo_rows, listed_bytes, sweeps_needed
from yesnt.temporal.params import EnergyParams

TYPICAL_CONFIDENCE = 0.1
"""Data weight that the halo is computed for; rarer, weaker tracks are left to the exchange sweeps."""

WEAKEST_CONFIDENCE = 0.02
"""Data weight down to which the sweeps reach the tolerance where memory has no room for joint sweeps."""

ROUND = 3
"""Sweeps of a round: two colours of a chessboard of blocks, and a joint sweep (exchange.py)."""

ROUNDS = 2
"""Rounds that are planned: one suffices where the joint sweep can hold all unconverged pixels, the next confirms it."""

SHORTEST = 16
"""Frames below which a chunk is divided into bands of rows instead of made shorter. Half and a quarter of it are used
for shots whose bands would still be too large."""

RESIDENT = 470e6
"""Bytes of a worker that has decomposed and relit frames, cleared its array cache and returned freed pages."""

DECOMPOSING, DECOMPOSING_PIXEL, MOST = 0.615e9, 300, 2e9
"""Bytes of a worker that decomposes a frame: constant part, part for each pixel (measured: 0.58 to 0.62 GB at 256x384),
and upper limit. Unless the job sets `temporal.memory`, the solver takes no more than that, so a long shot needs no
larger workers than a short one."""

READING = 60
"""Bytes per pixel of a frame while it is read whole and cut to a block: plate, observation, flow, confidence."""

HALO_ROWS = 16
"""Largest halo of a band, in rows; the exchange sweeps do the rest."""

REACH_SHARE = 48
"""Bands follow vertical motion of up to 1/48 of the height (and at least 16 pixels) per frame; longer links are cut."""


@dataclass(frozen=True)
class Extent:
    """Size of a shot's frames and how much of them is matte.

    Attributes:
        height: rows.
        width: columns.
        densest: share of matte pixels in the densest sixteenth of the rows; it sizes the bands.
        mean: share of matte pixels in all rows; None: unknown, `densest` is used.
    """

    height: int
    width: int
    densest: float = 1.0
    mean: float | None = None

    def share(self, rows: int) -> float:
        """Share of matte pixels in so many rows, at worst."""
        return self.densest if self.mean is None or rows < self.height else self.mean


@dataclass(frozen=True)
class ChunkPlan:
    """Lengths of chunks, halos and bands, and how often blocks exchange their borders.

    Attributes:
        chunk: frames of a chunk at most; the whole sequence where memory allows.
        halo: frames read on both sides of a chunk.
        sweeps: exchanges after the first solve, at most; a sweep that would change nothing keeps the values.
        bands: rows; a single band where a chunk fits into memory whole.
        reach: rows that a band reads around its outer rows in an exchange sweep, at most; 0 for a single band.
        peak_bytes: predicted resident memory of a worker that solves a block.
        joint: pixels that a joint sweep may list; 0: memory has no room for one.
    """

    chunk: int
    halo: int
    sweeps: int
    bands: tuple[Block, ...]
    reach: int = 0
    peak_bytes: float = 0.0
    joint: int = 0

    @property
    def whole(self) -> bool:
        """Whether a block holds all rows."""
        return len(self.bands) == 1

    def touched(self, band: Block, sweep: int) -> tuple[int, ...]:
        """Bands whose rows a band may load in a sweep."""
        reach = self.reach if sweep else 0
        first, last = band.outer.start - reach, band.outer.stop + reach
        return tuple(b.index for b in self.bands if b.core.start < last and b.core.stop > first)


def plan_chunks(
    params: EnergyParams, temporal: TemporalInput, tolerance: float, frames: int, extent: Extent
) -> ChunkPlan:
    """Chunks, halo, sweeps and bands for a job.

    A sequence that fits into the job's memory is one chunk: that is the least work, and exact. Otherwise the halo
    follows the decay formula for a typical confidence, but is at most half a chunk, since its frames are solved twice,
    and a quarter where bands are needed; the sweeps do the rest (temporal/blocks.py).

    Args:
        params: of the energy.
        temporal: the job's section; a chunk, halo or number of sweeps set there is used unchanged.
        tolerance: share of a change outside a block that may be missing inside.
        frames: length of the shot.
        extent: of its frames.
    """
    needed = halo_frames(params, TYPICAL_CONFIDENCE, tolerance)
    longest = _chunk_length(temporal, needed, frames, extent)
    shorter = (SHORTEST // 2, SHORTEST // 4) if temporal.chunk is None and longest == SHORTEST else ()
    for chunk in (longest, *shorter):
        plan = _plan_of(chunk, params, temporal, tolerance, frames, extent)
        if plan.peak_bytes <= _allowed(temporal, extent):
            break
    return plan


def _plan_of(
    chunk: int, params: EnergyParams, temporal: TemporalInput, tolerance: float, frames: int, extent: Extent
) -> ChunkPlan:
    """The plan for one length of chunks; its peak exceeds the memory where bands cannot be made narrower."""
    needed = halo_frames(params, TYPICAL_CONFIDENCE, tolerance)
    for share in (2, 4):
        halo = temporal.halo if temporal.halo is not None else min(needed, max(1, chunk // share))
        loaded = min(frames, chunk + 2 * halo + 2)
        rows = _affordable_rows(temporal, loaded, extent)
        if rows >= extent.height:
            break
    joint = _joint_pixels(temporal, frames, extent)
    sweeps = _sweeps(params, temporal, tolerance, halo, joint > 0)
    plan = ChunkPlan(chunk, halo, sweeps, row_bands(extent.height, extent.height, 0), joint=joint)
    if rows >= extent.height:
        return replace(plan, peak_bytes=_peak(loaded, extent.height, extent))
    border = min(halo_rows(params, TYPICAL_CONFIDENCE, tolerance), HALO_ROWS)
    reach = max(16, extent.height // REACH_SHARE)
    # Bands narrower than half of what they only read would cost too much time; `yesnt plan` prints the peak instead.
    core = max(rows - 2 * (border + reach), border + reach)
    bands, peak = row_bands(extent.height, core, border), _peak(loaded, core + 2 * (border + reach), extent)
    return replace(plan, bands=bands, reach=reach, peak_bytes=peak)


def fits_whole(temporal: TemporalInput, frames: int, extent: Extent) -> bool:
    """Whether a chunk of the job's length, with half of it as halo on each side, or the whole shot fits into memory."""
    loaded = frames if temporal.chunk is None else min(frames, 2 * temporal.chunk + 2)
    return _affordable_rows(temporal, loaded, extent) >= extent.height


def _chunk_length(temporal: TemporalInput, needed: int, frames: int, extent: Extent) -> int:
    """Frames of a chunk: as many as memory allows with halo and border, but at least `SHORTEST`."""
    if temporal.chunk is not None:
        return temporal.chunk
    longest = int(_free(temporal, extent) // block_bytes(1, extent.height, extent.width, extent.share(extent.height)))
    if longest >= frames:
        return frames
    halo = needed if temporal.halo is None else temporal.halo
    with_halo = longest - 2 - 2 * halo
    return max(SHORTEST, with_halo, (longest - 2) // 2 if temporal.halo is None else 0)


def _sweeps(params: EnergyParams, temporal: TemporalInput, tolerance: float, halo: int, jointly: bool) -> int:
    """Sweeps after the first; whole rounds if there are joint ones."""
    if not jointly:
        needed = sweeps_needed(params, WEAKEST_CONFIDENCE, tolerance, halo)
        return needed if temporal.sweeps is None else temporal.sweeps
    return ROUND * ROUNDS if temporal.sweeps is None else ROUND * math.ceil(temporal.sweeps / ROUND)


def _joint_pixels(temporal: TemporalInput, frames: int, extent: Extent) -> int:
    """Matte pixels that a joint task may list, next to two masks of the whole sequence; 0 if less than one frame's."""
    pixels = extent.height * extent.width
    free = _free(temporal, extent) - 2 * frames * pixels / 8  # a bit a pixel
    listed = int(free // listed_bytes())
    return listed if listed >= extent.share(extent.height) * pixels else 0


def matte_extent(job: Job) -> Extent:
    """The extent of a job's frames, measured on three of them; the densest share is rounded up to a twentieth."""
    middle, window, densest, means = len(job.frames) // 2, max(1, job.height // 16), 0.0, []
    for frame in {job.frames[0], job.frames[middle], job.frames[-1]}:
        rows = (read_matte(job, frame) > 0.5).mean(axis=1)
        densest = max(densest, float(np.convolve(rows, np.ones(window) / window, "valid").max()))
        means.append(float(rows.mean()))
    return Extent(job.height, job.width, min(1.0, math.ceil(20 * densest + 1e-9) / 20), max(means))


def _affordable_rows(temporal: TemporalInput, frames: int, extent: Extent) -> int:
    """Rows that a task may load."""
    free = _free(temporal, extent)
    if block_bytes(frames, extent.height, extent.width, extent.share(extent.height)) <= free:
        return extent.height
    return min(extent.height - 1, band_rows(frames, extent.width, extent.densest, int(free))) if free > 0 else 0


def _free(temporal: TemporalInput, extent: Extent) -> float:
    """Bytes that a task's lists may take."""
    return max(0.0, _allowed(temporal, extent) - _peak(0, 0, extent))


def _allowed(temporal: TemporalInput, extent: Extent) -> float:
    """Bytes that a worker may hold."""
    usual = min(MOST, DECOMPOSING + DECOMPOSING_PIXEL * extent.height * extent.width)
    return usual if temporal.memory is None else temporal.memory * 1e9


def _peak(frames: int, rows: int, extent: Extent) -> float:
    lists = block_bytes(frames, rows, extent.width, extent.share(rows))
    return RESIDENT + READING * extent.height * extent.width + lists
