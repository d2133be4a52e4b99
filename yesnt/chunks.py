"""How a shot is cut for the temporal solver: halo, exchange sweeps, and which frames each sweep takes from the last."""

from __future__ import annotations

from dataclasses import dataclass

from yesnt.blocks import Block
from yesnt.shot import TemporalInput
from yesnt.temporal.blocks import halo_frames, sweeps_needed
from yesnt.temporal.params import EnergyParams

TYPICAL_CONFIDENCE = 0.1
"""Data weight that the halo is made for: weaker tracks are rarer, and the exchange sweeps reach them."""

WEAKEST_CONFIDENCE = 0.02
"""Data weight up to which the planned sweeps reach the tolerance; each record of a chunk tells its last seam."""


@dataclass(frozen=True)
class ChunkPlan:
    """How long a block's halo is, and how often blocks exchange their borders.

    Attributes:
        halo: frames read on both sides of a chunk.
        sweeps: exchanges after the first solve, at most; one that would change nothing keeps what is there.
    """

    halo: int
    sweeps: int

    def loaded(self, block: Block, length: int, sweep: int) -> range:
        """Positions that a block loads in a sweep: its outer span, and from sweep 1 on a border frame on each side."""
        if sweep == 0:
            return range(block.outer.start, block.outer.stop)
        return range(max(0, block.outer.start - 1), min(length, block.outer.stop + 1))


def plan_chunks(params: EnergyParams, temporal: TemporalInput, tolerance: float) -> ChunkPlan:
    """Halo and sweeps for a job.

    The halo follows the decay formula for a typical confidence but is at most half a chunk, since every frame of it is
    solved twice; sweeps then bring the rest (temporal/blocks.py).

    Args:
        params: of the energy.
        temporal: the job's section; its own halo or sweeps are taken as they are.
        tolerance: share of a change outside that may be missing inside.
    """
    halo = temporal.halo
    if halo is None:
        halo = min(halo_frames(params, TYPICAL_CONFIDENCE, tolerance), max(1, temporal.chunk // 2))
    sweeps = temporal.sweeps
    if sweeps is None:
        sweeps = sweeps_needed(params, WEAKEST_CONFIDENCE, tolerance, halo)
    return ChunkPlan(halo, sweeps)
