"""Which block of the temporal solve is solved when, and which stage holds what is known of a frame: pure arithmetic.

Sweep 0 solves all blocks (chunk and band) with free ends. Then come rounds of three sweeps: blocks of one colour of a
chessboard, blocks of the other (neighbours that were solved side by side would pass each other by), and a joint sweep
that solves what still moves in all frames at once (temporal/joint.py). Where the job's memory has no room for that,
the two colours go on by turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

from yesnt.core.blocks import Block, chunk_blocks
from yesnt.io.store import ArrayForm
from yesnt.planning.chunks import ROUND, ChunkPlan


@dataclass(frozen=True)
class Exchange:
    """The schedule of a shot.

    Attributes:
        length: frames.
        chunks: how it is cut.
    """

    length: int
    chunks: ChunkPlan

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Chunks with their halo, in positions of the sequence."""
        return chunk_blocks(self.length, self.chunks.chunk, self.chunks.halo)

    @property
    def sweeps(self) -> int:
        """Sweeps after the first solve; none if there is one block only."""
        return 0 if len(self.blocks) == 1 and self.chunks.whole else self.chunks.sweeps

    def is_joint(self, sweep: int) -> bool:
        """Whether a sweep is one task over all frames."""
        return self.chunks.joint > 0 and sweep > 0 and sweep % ROUND == 0

    @property
    def ends_jointly(self) -> bool:
        """Whether the last sweep leaves whole frames of the whole shot: nothing is left to be joined."""
        return self.is_joint(self.sweeps)

    def solved(self, sweep: int) -> Iterator[tuple[Block, Block]]:
        """Chunk and band of every block that is solved by itself in a sweep."""
        for chunk, band in product(self.blocks, self.chunks.bands):
            if sweep in self.solved_in(chunk.index, band.index):
                yield chunk, band

    def solved_in(self, chunk: int, band: int) -> tuple[int, ...]:
        """Sweeps in which a block is solved by itself."""
        period = ROUND if self.chunks.joint > 0 else 2
        turn = 1 if (chunk + band) % 2 else 2
        return (0, *(sweep for sweep in range(1, 1 + self.sweeps) if sweep % period == turn % period))

    def held_in(self, chunk: int, band: int) -> tuple[int, ...]:
        """Sweeps that leave a value of a block."""
        joint = (sweep for sweep in range(1 + self.sweeps) if self.is_joint(sweep))
        return tuple(sorted({*self.solved_in(chunk, band), *joint}))

    def stage(self, chunk: int, band: int, sweep: int) -> str:
        """The stage of a sweep: the last one of whole frames is `solve`; others are `solve.0`, or `solve.0.r3`."""
        if self.is_joint(sweep):
            return "solve" if sweep == self.sweeps else f"solve.{sweep}"
        if not self.chunks.whole:
            return f"solve.{sweep}.r{band}"
        return "solve" if sweep == self.held_in(chunk, band)[-1] else f"solve.{sweep}"

    def before(self, position: int, bands: tuple[int, ...], sweep: int) -> dict[int, str]:
        """Band -> the stage that holds what was known of a position before a sweep."""
        chunk = self.chunk_of(position)
        known = {band: max(k for k in self.held_in(chunk, band) if k < sweep) for band in bands}
        return {band: self.stage(chunk, band, last) for band, last in known.items()}

    def chunk_of(self, position: int) -> int:
        """Number of the chunk whose core holds a position."""
        return next(b.index for b in self.blocks if b.core.start <= position < b.core.stop)

    def index_of(self, stage: str, position: int) -> int:
        """Index of the node that commits a position of a stage: its chunk, or 0 if one node commits all frames."""
        name, _, rest = stage.partition(".")
        sweep = self.sweeps if name == stage else int(rest.partition(".")[0])
        return 0 if self.is_joint(sweep) and ".r" not in stage else self.chunk_of(position)

    def arrays(self) -> dict[str, ArrayForm]:
        """Arrays of the store that sweeps before the last one write; those of bands with their rows."""
        whole = [k for k in range(self.sweeps) if self.chunks.whole or self.is_joint(k)]
        arrays: dict[str, ArrayForm] = {f"solve.{sweep}": "material" for sweep in whole}
        if self.chunks.whole:
            return arrays
        sweeps = [k for k in range(1 + self.sweeps) if not self.is_joint(k)]
        bands = product(sweeps, self.chunks.bands)
        return arrays | {f"solve.{sweep}.r{band.index}": ("material", len(band.core)) for sweep, band in bands}
