"""Settings of the ensemble. Importing it imports no torch: jobs are checked and planned without a network."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class EnsembleSettings:
    """How many members are drawn, and where.

    Attributes:
        samples: members K; with a tolerance, the most that a patch may get.
        overlap: least overlap of neighbouring patches as a fraction of their side, in [0, 1).
        tolerance: standard error of the mean of roughness or metallic (in their unit, 1 = full range) at which a patch
            gets no more members; 0: all K members are drawn everywhere.
        antithetic: members 2j and 2j + 1 use one noise field with opposite signs. Each member keeps its distribution,
            and the parts of the result that are odd in the noise cancel in the mean: for the mean of roughness two
            members are as good as eight independent ones.
        first: members drawn before the tolerance is tested; each further round doubles the number.
        keyframe_step: every so many frames one is drawn in full. The frames between use its estimate along the flow and
            draw only the patches that it does not cover. 1: every frame is drawn in full.
        reuse_validity: least validity of the flow along the whole way to the keyframe; pixels below are not reused.
        reuse_confidence: least confidence of the keyframe's estimate (of roughness and metallic); pixels below are not
            reused.
        reuse_share: a patch between keyframes is not drawn if the reused estimate covers this fraction of its matte.
    """

    samples: int = 8
    overlap: float = 0.25
    tolerance: float = 0.0
    antithetic: bool = True
    first: int = 2
    keyframe_step: int = 1
    reuse_validity: float = 0.5
    reuse_confidence: float = 0.5
    reuse_share: float = 0.9

    def __post_init__(self) -> None:
        """Checks the ranges.

        Raises:
            ValueError: a field is out of its range; names it.
        """
        if self.samples < 1 or self.first < 2:
            raise ValueError(f"samples {self.samples} must be at least 1 and first {self.first} at least 2")
        if not 0 <= self.overlap < 1:
            raise ValueError(f"overlap {self.overlap} must be in [0, 1)")
        if self.tolerance < 0:
            raise ValueError(f"tolerance {self.tolerance} must not be negative")
        if self.keyframe_step < 1:
            raise ValueError(f"keyframe_step {self.keyframe_step} must be at least 1")
        for name in ("reuse_validity", "reuse_confidence", "reuse_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} {getattr(self, name)} must be in [0, 1]")

    def rounds(self) -> tuple[range, ...]:
        """Returns the member numbers of each round: one round without a tolerance, else 2, 2, 4, 8, ... members."""
        if self.tolerance == 0:
            return (range(self.samples),)
        edges = [0, min(self.first, self.samples)]
        while edges[-1] < self.samples:
            edges.append(min(2 * edges[-1], self.samples))
        return tuple(range(a, b) for a, b in pairwise(edges))


REUSE_ONLY = ("keyframe_step", "reuse_validity", "reuse_confidence", "reuse_share")
"""Settings that only affect frames that reuse a keyframe's estimate."""


def keyframe_after(position: int, length: int, step: int) -> int:
    """Position of the keyframe that a frame uses: the next multiple of `step`, or the last frame.

    Args:
        position: position of the frame in the shot.
        length: frames of the shot.
        step: positions from one keyframe to the next.
    """
    return min(-(-position // step) * step, length - 1)


def keyframes_taken(frames: Sequence[int], step: int, dead: Set[int], unlinked: Set[int]) -> dict[int, int]:
    """Maps frames to the keyframes whose estimate they use. Keyframes are not in it.

    A frame that cannot reach its keyframe is drawn in full, and so is not in it either.

    Args:
        frames: numbers of the shot, in order.
        step: positions from one keyframe to the next.
        dead: frames that cannot be decomposed.
        unlinked: frames without flow to the next.
    """
    found = {}
    for position, frame in enumerate(frames):
        key = keyframe_after(position, len(frames), step)
        reached = frames[key] not in dead and unlinked.isdisjoint(frames[position:key])
        if key != position and frame not in dead and reached:
            found[frame] = frames[key]
    return found
