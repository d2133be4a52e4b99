"""Parameters of the ensemble: light to import, so that a job can be checked and planned without a network."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class EnsembleSettings:
    """How many members are drawn and where.

    Attributes:
        samples: members K; with a tolerance, the most that a patch may get.
        overlap: least overlap of neighbouring patches, as a fraction of the patch's side, in [0, 1).
        tolerance: standard error of the mean (roughness or metallic, 1 = full range) at which a patch gets no more
            members; 0 draws all K everywhere.
        antithetic: members 2j and 2j + 1 share one noise field with opposite signs. Each is as good a draw as any, but
            what is odd in the noise leaves the mean: two members then serve the mean of roughness as well as eight.
        first: members drawn before the tolerance is looked at; then the number is doubled in every round.
        keyframe_step: every so many frames one is drawn in full; those between take its estimate along the flow and
            draw only where that fails. 1: every frame is drawn in full.
        reuse_validity: validity of the flow along the whole way to the keyframe below which a pixel is drawn anew.
        reuse_confidence: confidence of the keyframe's estimate (the lesser of roughness and metallic) below which
            a pixel is drawn anew.
        reuse_share: a patch of a frame between keyframes is not drawn if the estimate reaches this share of its matte.
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
        """Refuses what has no meaning.

        Raises:
            ValueError: a field is out of its range.
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
        """Member numbers of every round: all in one without a tolerance, else 2, 2, 4, 8, ... of them."""
        if self.tolerance == 0:
            return (range(self.samples),)
        edges = [0, min(self.first, self.samples)]
        while edges[-1] < self.samples:
            edges.append(min(2 * edges[-1], self.samples))
        return tuple(range(a, b) for a, b in pairwise(edges))


REUSE_ONLY = ("keyframe_step", "reuse_validity", "reuse_confidence", "reuse_share")
"""Fields that a frame's result depends on only if it takes a keyframe's estimate."""


def keyframe_after(position: int, length: int, step: int) -> int:
    """Position of the keyframe that a frame takes from: itself, the next multiple of `step`, or the last frame."""
    return min(-(-position // step) * step, length - 1)


def keyframes_taken(frames: Sequence[int], step: int, dead: Set[int], unlinked: Set[int]) -> dict[int, int]:
    """Frame -> the keyframe whose estimate it takes; keyframes themselves are not in it.

    A frame that cannot reach its keyframe is one.

    Args:
        frames: numbers of the shot, in order.
        step: of keyframes, in positions.
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
