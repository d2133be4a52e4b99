"""Which block of the temporal solver is solved in which sweep, and which stage holds a frame's last value.

Sweep 0 solves all blocks (a chunk of frames, a band of rows) with free ends. Rounds of three sweeps follow: the blocks
of one colour of a chessboard, those of the other colour (adjacent blocks that are solved in parallel would not see each
other's change), and a joint sweep that solves the unconverged pixels of all frames together (temporal/joint.py). Where
the job's memory has no room for a joint sweep, the two colours alternate. Index arithmetic only; no array is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import TYPE_CHECKING

from yesnt.core.blocks import Block, Chunks
from yesnt.core.stage_id import StageId
from yesnt.planning.chunks import ROUND, ChunkPlan

if TYPE_CHECKING:
    from yesnt.io.store_layout import ArrayForm

SOLVE = StageId("solve")


@lru_cache(maxsize=4096)
def sweep_stage(sweep: int, band: int | None = None) -> StageId:
    """The stage of a sweep before the last one; one object for each, so that it is hashed once."""
    return StageId("solve", sweep, band)


@dataclass(frozen=True)
class Exchange:
    """The schedule of a shot.

    Attributes:
        length: frames.
        chunks: lengths of chunks and halos, bands of rows, sweeps.
    """

    length: int
    chunks: ChunkPlan

    @cached_property
    def blocks(self) -> Chunks:
        """Chunks with their halo, in positions of the sequence."""
        return Chunks(self.length, self.chunks.chunk, self.chunks.halo)

    @cached_property
    def sweeps(self) -> int:
        """Sweeps after the first solve; none if there is one block only."""
        return 0 if len(self.blocks) == 1 and self.chunks.whole else self.chunks.sweeps

    def is_joint(self, sweep: int) -> bool:
        """Whether a sweep is one task over all frames."""
        return self.chunks.joint > 0 and sweep > 0 and sweep % ROUND == 0

    @property
    def ends_jointly(self) -> bool:
        """Whether the last sweep leaves whole frames of the whole shot: there are no bands to join."""
        return self.is_joint(self.sweeps)

    def solved(self, sweep: int) -> Iterator[tuple[Block, Block]]:
        """Chunk and band of every block that is solved by itself in a sweep."""
        for chunk, band in product(self.blocks, self.chunks.bands):
            if sweep in self.solved_in(chunk.index, band.index):
                yield chunk, band

    def solved_in(self, chunk: int, band: int) -> tuple[int, ...]:
        """Sweeps in which a block is solved by itself."""
        return self._solved[(chunk + band) % 2]

    def held_in(self, chunk: int, band: int) -> tuple[int, ...]:
        """Sweeps that leave a value of a block, ascending."""
        return self._held[(chunk + band) % 2]

    @cached_property
    def _solved(self) -> tuple[tuple[int, ...], ...]:
        """Sweeps that solve blocks of either colour of the chessboard."""
        period = ROUND if self.chunks.joint > 0 else 2
        sweeps = range(1 + self.sweeps)
        return tuple(tuple(k for k in sweeps if k == 0 or k % period == turn % period) for turn in (2, 1))

    @cached_property
    def _held(self) -> tuple[tuple[int, ...], ...]:
        """Sweeps that leave a value of blocks of either colour."""
        joint = [k for k in range(1 + self.sweeps) if self.is_joint(k)]
        return tuple(tuple(sorted({*solved, *joint})) for solved in self._solved)

    def last_solve(self, chunk: int, band: int, sweep: int) -> int:
        """The sweep before this one in which a block was last solved by itself; 0 for the first."""
        return max((k for k in self.solved_in(chunk, band) if k < sweep), default=0)

    def stage(self, chunk: int, band: int, sweep: int) -> StageId:
        """The stage that stores a block's value of a sweep: `solve` for the last one of whole frames."""
        if self.is_joint(sweep):
            return SOLVE if sweep == self.sweeps else sweep_stage(sweep)
        if not self.chunks.whole:
            return sweep_stage(sweep, band)
        return SOLVE if sweep == self.held_in(chunk, band)[-1] else sweep_stage(sweep)

    def before(self, chunk: int, bands: Iterable[int], sweep: int) -> dict[int, StageId]:
        """Band -> the stage that stores the last value of a chunk before a sweep."""
        known = {band: max(k for k in self.held_in(chunk, band) if k < sweep) for band in bands}
        return {band: self.stage(chunk, band, last) for band, last in known.items()}

    def index_of(self, stage: StageId, chunk: int) -> int:
        """Index of the node that commits a chunk: the chunk's number, or 0 if one node commits all frames."""
        sweep = self.sweeps if stage.sweep is None else stage.sweep
        return 0 if self.is_joint(sweep) and stage.band is None else chunk

    def loaded(self, chunk: Block, sweep: int) -> range:
        """Positions that a block reads: its outer span, and from sweep 1 on a border frame on each side."""
        if sweep == 0:
            return range(chunk.outer.start, chunk.outer.stop)
        return range(max(0, chunk.outer.start - 1), min(self.length, chunk.outer.stop + 1))

    def arrays(self) -> dict[str, ArrayForm]:
        """Arrays of the store for sweeps before the last one; those of bands with their rows."""
        whole = [k for k in range(self.sweeps) if self.chunks.whole or self.is_joint(k)]
        arrays: dict[str, ArrayForm] = {sweep_stage(k).array("material"): "material" for k in whole}
        if self.chunks.whole:
            return arrays
        sweeps = [k for k in range(1 + self.sweeps) if not self.is_joint(k)]
        for sweep, band in product(sweeps, self.chunks.bands):
            arrays[sweep_stage(sweep, band.index).array("material")] = ("material", len(band.core))
        return arrays
