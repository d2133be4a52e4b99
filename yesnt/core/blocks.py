"""Index arithmetic of patches, chunks and halos: pure, no images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Span:
    """Half-open range of positions [start, stop) in a sequence."""

    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.start, self.stop))

    @property
    def slice(self) -> slice:
        """The span as a slice."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class Block:
    """What a temporal task holds: a core that it writes and the halo around it that it only reads."""

    index: int
    core: Span
    outer: Span

    @property
    def core_in_outer(self) -> slice:
        """Where the core sits inside the outer span."""
        return slice(self.core.start - self.outer.start, self.core.stop - self.outer.start)


@dataclass(frozen=True)
class Chunks:
    """Splits `length` frames into chunks of at most `chunk`, each with up to `halo` frames on both sides.

    Chunks differ by at most one frame in size, so the last one is never much shorter than the others. A chunk, and the
    chunk of a frame, are computed without listing all chunks.

    Raises:
        ValueError: a size is not positive or the halo is negative.
    """

    length: int
    chunk: int
    halo: int

    def __post_init__(self) -> None:
        """Refuses sizes that split nothing."""
        if self.length < 1 or self.chunk < 1 or self.halo < 0:
            raise ValueError(f"length {self.length} and chunk {self.chunk} must be positive, halo {self.halo} >= 0")

    def __len__(self) -> int:
        return -(-self.length // self.chunk)

    def __getitem__(self, index: int) -> Block:
        if not 0 <= index < len(self):
            raise IndexError(f"chunk {index} of {len(self)}")
        start, stop = (self.length * i // len(self) for i in (index, index + 1))
        outer = Span(max(0, start - self.halo), min(self.length, stop + self.halo))
        return Block(index, Span(start, stop), outer)

    def __iter__(self) -> Iterator[Block]:
        return (self[index] for index in range(len(self)))

    def index_of(self, position: int) -> int:
        """Number of the chunk whose core holds a position in [0, length)."""
        return ((position + 1) * len(self) - 1) // self.length  # the last i with length * i // count <= position


def chunk_blocks(length: int, chunk: int, halo: int) -> tuple[Block, ...]:
    """All chunks of `Chunks`."""
    return tuple(Chunks(length, chunk, halo))


def patch_origins(length: int, patch: int, overlap: int) -> tuple[int, ...]:
    """Origins of patches of size `patch` that cover [0, length) and overlap by at least `overlap`.

    One dimension; positions are spread evenly, so no two patches overlap more than they must. A length of at most
    `patch` gives the single origin 0 (the caller pads).

    Raises:
        ValueError: overlap is not in [0, patch).
    """
    if not 0 <= overlap < patch:
        raise ValueError(f"overlap {overlap} must be in [0, {patch})")
    if length <= patch:
        return (0,)
    steps = -(-(length - patch) // (patch - overlap))
    return tuple((length - patch) * i // steps for i in range(steps + 1))


def row_bands(height: int, band: int, halo: int) -> tuple[Block, ...]:
    """Splits rows as `chunk_blocks` splits frames."""
    return chunk_blocks(height, band, halo)
