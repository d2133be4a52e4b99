"""How a shot is cut for the temporal solver: chunks of frames with a halo, bands of rows, and exchange sweeps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from yesnt.blocks import Block, Span, row_bands
from yesnt.io.capture import read_matte
from yesnt.shot import Job, TemporalInput
from yesnt.temporal.blocks import band_rows, block_bytes, halo_frames, halo_rows, sweeps_needed
from yesnt.temporal.params import EnergyParams

TYPICAL_CONFIDENCE = 0.1
"""Data weight that the halo is made for: weaker tracks are rarer, and the exchange sweeps reach them."""

WEAKEST_CONFIDENCE = 0.02
"""Data weight up to which the planned sweeps reach the tolerance; each record of a chunk tells its last seam."""

RESIDENT = 400e6
"""Bytes of a worker that has loaded what the solver needs."""

READING = 60
"""Bytes per pixel of a frame while it is read whole and cut: plate, observation, flow, confidence."""

HALO_ROWS = 16
"""Most rows of halo of a band; the exchange sweeps bring the rest."""

REACH_SHARE = 48
"""Bands follow vertical motion up to a 48th of the height (and at least 16 pixels) per frame; longer links are cut."""


@dataclass(frozen=True)
class Extent:
    """What is known of a shot's frames before they are solved: size, and the share of matte pixels where it is densest.

    The share counts windows of a sixteenth of the rows.
    """

    height: int
    width: int
    matte_share: float = 1.0


@dataclass(frozen=True)
class ChunkPlan:
    """How long a block's halo is, and how often blocks exchange their borders.

    Attributes:
        halo: frames read on both sides of a chunk.
        sweeps: exchanges after the first solve, at most; one that would change nothing keeps what is there.
        bands: rows; a single band where a chunk fits into memory whole.
        reach: rows that a band reads around its outer rows in an exchange, at most; 0 for a single band.
        peak_bytes: predicted resident memory of a worker that solves a block.
    """

    halo: int
    sweeps: int
    bands: tuple[Block, ...]
    reach: int = 0
    peak_bytes: float = 0.0

    @property
    def whole(self) -> bool:
        """Whether a block holds all rows."""
        return len(self.bands) == 1

    def loaded(self, block: Block, length: int, sweep: int) -> range:
        """Positions that a block loads in a sweep: its outer span, and from sweep 1 on a border frame on each side."""
        if sweep == 0:
            return range(block.outer.start, block.outer.stop)
        return range(max(0, block.outer.start - 1), min(length, block.outer.stop + 1))

    def touched(self, band: Block, sweep: int) -> tuple[int, ...]:
        """Bands whose rows a band may load in a sweep."""
        reach = self.reach if sweep else 0
        first, last = band.outer.start - reach, band.outer.stop + reach
        return tuple(b.index for b in self.bands if b.core.start < last and b.core.stop > first)


def plan_chunks(
    params: EnergyParams, temporal: TemporalInput, tolerance: float, frames: int, extent: Extent
) -> ChunkPlan:
    """Halo, sweeps and bands for a job.

    The halo follows the decay formula for a typical confidence but is at most half a chunk, since every frame of it is
    solved twice, and a quarter where bands are needed; sweeps then bring the rest (temporal/blocks.py).

    Args:
        params: of the energy.
        temporal: the job's section; its own halo or sweeps are taken as they are.
        tolerance: share of a change outside that may be missing inside.
        frames: length of the shot.
        extent: of its frames.
    """
    needed = halo_frames(params, TYPICAL_CONFIDENCE, tolerance)
    for share in (2, 4):
        halo = temporal.halo if temporal.halo is not None else min(needed, max(1, temporal.chunk // share))
        loaded = min(frames, temporal.chunk + 2 * halo + 2)
        rows = _affordable_rows(temporal, loaded, extent)
        if rows >= extent.height:
            break
    sweeps = temporal.sweeps
    if sweeps is None:
        sweeps = sweeps_needed(params, WEAKEST_CONFIDENCE, tolerance, halo)
    if rows >= extent.height:
        everything = Span(0, extent.height)
        return ChunkPlan(halo, sweeps, (Block(0, everything, everything),), 0, _peak(loaded, extent.height, extent))
    border = min(halo_rows(params, TYPICAL_CONFIDENCE, tolerance), HALO_ROWS)
    reach = max(16, extent.height // REACH_SHARE)
    # Narrower than half of what they only read, bands would cost more time than memory is worth: `plan` tells the peak.
    core = max(rows - 2 * (border + reach), border + reach)
    rows = core + 2 * (border + reach)
    return ChunkPlan(halo, sweeps, row_bands(extent.height, core, border), reach, _peak(loaded, rows, extent))


def fits_whole(temporal: TemporalInput, frames: int, extent: Extent) -> bool:
    """Whether a chunk with half its length of halo on both sides fits into the job's memory."""
    loaded = min(frames, 2 * temporal.chunk + 2)
    return _affordable_rows(temporal, loaded, extent) >= extent.height


def matte_share(job: Job) -> float:
    """Share of matte pixels in the densest sixteenth of the rows of three frames, rounded up to a twentieth."""
    middle, window, found = len(job.frames) // 2, max(1, job.height // 16), 0.0
    for frame in {job.frames[0], job.frames[middle], job.frames[-1]}:
        rows = (read_matte(job, frame) > 0.5).mean(axis=1)
        found = max(found, float(np.convolve(rows, np.ones(window) / window, "valid").max()))
    return min(1.0, math.ceil(20 * found + 1e-9) / 20)


def _affordable_rows(temporal: TemporalInput, frames: int, extent: Extent) -> int:
    """Rows that a task may load."""
    free = temporal.memory * 1e9 - _peak(0, 0, extent)
    return band_rows(frames, extent.width, extent.matte_share, int(free)) if free > 0 else 0


def _peak(frames: int, rows: int, extent: Extent) -> float:
    lists = block_bytes(frames, rows, extent.width, extent.matte_share)
    return RESIDENT + READING * extent.height * extent.width + lists
