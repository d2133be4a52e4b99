"""Solving one block of the temporal energy: a chunk of frames, whole or in a band of rows (see temporal/blocks.py).

Frames are read one at a time and cut to the matte pixels of the block, so that a task's memory follows its block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.blocks import Block
from yesnt.core.errors import JobError
from yesnt.planning import settings as of
from yesnt.tasks.workspace import Workspace, release_memory
from yesnt.temporal import BlockLists, solve_lists
from yesnt.temporal.geometry import Geometry, PackedMasks, build_geometry, drop_spatial_term
from yesnt.temporal.outliers import bridge

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

SETTLED = 0.1
"""A block is left as it is if its border moved by less than this share of the tolerance since it was solved last."""


def solve_block(space: Workspace) -> None:
    """Commits the material of one block after one sweep."""
    window = _window(space)
    value, facts = _value(space, window)
    pending = set(space.pending())
    for position in space.node.arguments["block"].core:
        frame = space.job.frames[position]
        if frame not in pending:
            continue
        if value is None:
            keep(space, frame, facts, space.node.arguments["band"])
        else:
            space.commit(frame, {array_of(space.node.stage): _dense(space, window, value, frame)}, facts=facts)


def keep(space: Workspace, frame: int, facts: dict[str, Any], band: int | None) -> None:
    """Commits a frame (of a band; None: whole) as the sweep before left it, by a second name where the forms agree."""
    bands: tuple[Block, ...] = space.node.arguments["bands"]
    held, array = space.node.arguments["now"][frame], array_of(space.node.stage)
    if len(bands) == 1 or (band is not None and ".r" in held[band]):
        stage = held[band or 0]
        space.carry(frame, array, (stage, array_of(stage)), facts)
        return
    rows = slice(None) if band is None else bands[band].core.slice
    space.commit(frame, {array: known(space, held, frame)[:, rows]}, facts=facts)


def observed(space: Workspace, frame: int) -> Float32:
    """Mean of the members [2, H, W]; 0.5 for a frame without a decomposition."""
    if frame in space.node.arguments["absent"]:
        return np.full((2, space.job.height, space.job.width), 0.5, np.float32)
    return space.read("decompose", "observed", frame)


@dataclass(frozen=True)
class Window:
    """What a task loads.

    Attributes:
        frames: frame numbers.
        rows: rows of the frame.
        matte: [T, rows, W].
        fixed: [T, rows, W], True where a neighbour's value stands.
    """

    frames: tuple[int, ...]
    rows: slice
    matte: Mask | PackedMasks
    fixed: Mask | PackedMasks

    def pixels(self, index: int, frame: Float32) -> Float32:
        """Matte pixels [C, n] of a whole frame [C, H, W] at a position of the window."""
        return frame[:, self.rows][:, self.matte[index]]


def _window(space: Workspace) -> Window:
    start, stop = space.node.arguments["loaded"]
    block, band = space.node.arguments["block"], _band(space)
    frames = space.job.frames[start:stop]
    reach = _reach(space, frames) if space.node.arguments["now"] else 0
    rows = slice(max(0, band.outer.start - reach), min(space.job.height, band.outer.stop + reach))
    matte = np.stack([space.matte(frame)[rows] for frame in frames])
    fixed = np.ones(matte.shape, bool)
    inner = slice(block.outer.start - start, block.outer.stop - start)
    fixed[inner, band.outer.start - rows.start : band.outer.stop - rows.start] = False
    return Window(frames, rows, matte, fixed)


def _band(space: Workspace) -> Block:
    bands: tuple[Block, ...] = space.node.arguments["bands"]
    return bands[space.node.arguments["band"]]


def _reach(space: Workspace, frames: tuple[int, ...]) -> int:
    """Rows around a band that its links reach: what the flow's records say, at most what the job allows for."""
    records = [space.book.find("flow", frame) for frame in frames[:-1]]
    limit: int = space.node.arguments["reach"]
    return min(limit, max((limit if r is None else int(r.facts.get("reach", limit)) for r in records), default=0))


def _value(space: Workspace, window: Window) -> tuple[Float32 | None, dict[str, Any]]:
    """The solved material [2, N] of the window's matte pixels, or None for a block at rest, and facts."""
    arguments, temporal = space.node.arguments, space.job.shot.temporal
    if not temporal.enabled:
        return listed(window, lambda frame: observed(space, frame)), {}
    if not arguments["now"]:
        return solve_window(space, window, None)
    now = listed(window, lambda frame: known(space, arguments["now"][frame], frame))
    seam = _seam(space, window, now)
    if seam < SETTLED * temporal.tolerance:
        return None, {"seam": seam, "skipped": True}
    value, facts = solve_window(space, window, now)
    return value, facts | {"seam": min(seam, 1.0)}


def solve_window(space: Workspace, window: Window, start: Float32 | None) -> tuple[Float32, dict[str, Any]]:
    """Solves a window's free pixels from `start` [2, N] (None: from what was observed); value and facts."""
    temporal, params = space.job.shot.temporal, of.energy_params(space.job.shot)
    data = listed(window, lambda frame: observed(space, frame))
    confidence = listed(window, lambda frame: space.read("trust", "confidence", frame))
    links = Links(space, window)
    with space.kernel():  # it reads links as it goes; those are not counted
        geometry = build_geometry(window.matte, Part(links, 0), Part(links, 1), window.fixed)
        _drop_spatial_terms(geometry, space, window)
    lists = BlockLists(geometry, data, confidence, data if start is None else start)
    release_memory()  # the cache is full of what was read
    with space.kernel():
        value, stats = solve_lists(lists, params, SETTLED * temporal.tolerance, temporal.method)
    facts = {"iterations": stats.iterations, "gap": stats.gap, "pixels": stats.pixels, "rows": window.matte.shape[1]}
    return value, facts | ({"cut_links": links.cut} if links.cut else {})


def _drop_spatial_terms(geometry: Geometry, space: Workspace, window: Window) -> None:
    """Takes the spatial term from inconsistent frames, by their validity: the same pixels in every window."""
    links = Links(space, window)
    for t, frame in enumerate(window.frames[:-1]):
        if frame in links.inconsistent:
            drop_spatial_term(geometry, t, links.pair(t)[1][window.matte[t]] > 0)


def listed(window: Window, read: Callable[[int], Float32]) -> Float32:
    """Matte pixels [2, N] of all frames of a window; `read` gives a whole frame [2, H, W].

    Raises:
        JobError: a value is not finite inside the matte; the frame is named.
    """
    parts = []
    for index, frame in enumerate(window.frames):
        part = window.pixels(index, read(frame))
        if not np.isfinite(part).all():
            raise JobError(
                "The solver was given NaN or infinity", f"frame {frame}, inside the matte", "finite materials",
                "make the frame again: `yesnt retry`",
            )  # fmt: skip
        parts.append(part)
    return np.concatenate(parts, axis=1)


def known(space: Workspace, stages: Mapping[int, str], frame: int) -> Float32:
    """A frame as sweeps before left it: [2, H, W], 0 in rows of bands that are not asked for."""
    bands: tuple[Block, ...] = space.node.arguments["bands"]
    if len(bands) == 1:
        return space.read(stages[0], array_of(stages[0]), frame)
    whole = np.zeros((2, space.job.height, space.job.width), np.float32)
    for index, stage in stages.items():
        rows, values = bands[index].core.slice, space.read(stage, array_of(stage), frame)
        whole[:, rows] = values[:, rows] if values.shape[1] == space.job.height else values
    return whole


def _seam(space: Workspace, window: Window, now: Float32) -> float:
    """How far the border has moved since this block was last solved; infinite if it has met no border yet."""
    then: Mapping[int, Mapping[int, str]] = space.node.arguments["then"]
    if not then:
        return np.inf
    moved, first = 0.0, 0
    for index, frame in enumerate(window.frames):
        matte, fixed = window.matte[index], window.fixed[index]
        count = int(matte.sum())
        border = fixed[matte]
        if border.any():
            before = window.pixels(index, known(space, then[frame], frame))
            moved = max(moved, float(np.abs(now[:, first : first + count] - before)[:, border].max()))
        first += count
    return moved


def _dense(space: Workspace, window: Window, value: Float32, frame: int) -> Float32:
    """One frame's core rows [2, h, W]: the value inside the matte, what was observed outside."""
    index, core = window.frames.index(frame), _band(space).core
    first = sum(int(window.matte[t].sum()) for t in range(index))
    dense = observed(space, frame)[:, window.rows].copy()
    matte = window.matte[index]
    dense[:, matte] = value[:, first : first + int(matte.sum())]
    return dense[:, core.start - window.rows.start : core.stop - window.rows.start]


def join_bands(space: Workspace) -> None:
    """Puts a chunk's bands together; the record tells the worst of them."""
    parts: Mapping[int, Mapping[int, str]] = space.node.arguments["parts"]
    for frame in space.pending():
        records = [space.book.find(stage, frame) for stage in parts[frame].values()]
        facts: dict[str, Any] = {}
        for told in (record.facts for record in records if record is not None):
            for name in {"seam", "gap"} & set(told):
                facts[name] = max(facts.get(name, 0.0), told[name])
        space.commit(frame, {"material": known(space, parts[frame], frame)}, facts=facts)


class Links:
    """Flow [rows, W, 2] and validity [rows, W] of a window, read pair by pair; a pair without flow has validity 0."""

    def __init__(self, space: Workspace, window: Window) -> None:
        self._space, self._window = space, window
        self._limit = space.node.arguments["reach"] or np.inf
        self._index, self._pair = -1, (np.zeros(0, np.float32), np.zeros(0, np.float32))
        self.inconsistent = {frame for frame in window.frames if _inconsistent(space, frame)}
        self.cut = 0

    def pair(self, index: int) -> tuple[Float32, Float32]:
        """Flow and validity of a position of the window to the next; the last one read is kept."""
        if index != self._index:
            self._index, self._pair = index, self._read(index)
        return self._pair

    def _read(self, index: int) -> tuple[Float32, Float32]:
        space, window, frame = self._space, self._window, self._window.frames[index]
        shape = window.matte.shape[1:]
        if frame in space.node.arguments["unlinked"]:
            return np.zeros((*shape, 2), np.float32), np.zeros(shape, np.float32)
        flow = space.read("flow", "flow", frame)[:, window.rows].transpose(1, 2, 0)
        validity = space.read("flow", "validity", frame)[0, window.rows].copy()
        # Bands must agree on the energy, so what one of them cannot follow none does.
        long = (np.abs(flow[..., 1]) > self._limit - 1) & (validity > 0) & window.matte[index]
        self.cut += int(long.sum())
        validity[long] = 0
        if frame in self.inconsistent or window.frames[index + 1] in self.inconsistent:
            validity = bridge(validity)
        return flow, validity


def _inconsistent(space: Workspace, frame: int) -> bool:
    """Whether a frame lost its say as a whole (tasks/confidence.py)."""
    record = space.book.find("trust", frame)
    return record is not None and frame in record.facts.get("inconsistent", [])


@dataclass(frozen=True)
class Part:
    """One half of the links, as `build_geometry` asks for them."""

    links: Links
    half: int

    def __getitem__(self, index: int) -> Float32:
        return self.links.pair(index)[self.half]


def array_of(stage: str) -> str:
    """The array of the store that a sweep writes."""
    return "material" if stage == "solve" else stage
