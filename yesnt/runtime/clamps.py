"""What the frames of a run clamped or left out, from their records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from yesnt.io.record_index import RecordIndex
from yesnt.planning.graph import Graph
from yesnt.planning.stages import COMPOSITE, CORRECT, EVIDENCE, FIT, RELIGHT

CLAMPING = (FIT, EVIDENCE, CORRECT, RELIGHT, COMPOSITE)
"""Stages whose records count what was clamped or left out (`facts["clamped"]`)."""


def clamp_lines(frames: Iterable[int], graph: Graph, index: RecordIndex) -> list[str]:
    """A line for each kind of clamp among the frames that are done, with its count."""
    values, where = Counter[str](), Counter[str]()
    committed = {(node.stage, frame): node for node in graph if node.stage in CLAMPING for frame in node.frames}
    for frame in frames:
        for stage in CLAMPING:
            node, entry = committed.get((stage, frame)), index.find(stage, frame)
            if node is not None and entry is not None and entry.key == node.frame_key(frame):
                values.update(entry.clamped)
                where.update(entry.clamped.keys())
    return [f"{what}: {count:,} in {_frames(where[what])}" for what, count in sorted(values.items())]


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count:,} frames"
