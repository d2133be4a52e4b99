"""The part of a shot that a task of the temporal solver holds: its pixels as lists, its links, its solve."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.planning import settings as of
from yesnt.planning.stages import CONFIDENCE, FLOW
from yesnt.planning.task_records import SolveTask
from yesnt.tasks.decoded import release_memory
from yesnt.tasks.observations import observed
from yesnt.tasks.workspace import Workspace
from yesnt.temporal import BlockLists, solve_lists
from yesnt.temporal.bridging import bridge
from yesnt.temporal.geometry import Geometry, PackedMasks, build_geometry, drop_spatial_term

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Space = Workspace[SolveTask]

STEP = 0.1
"""Share of the job's tolerance below which the last iteration of a solve must move every pixel."""


@dataclass(frozen=True)
class Window:
    """What a task loads.

    Attributes:
        frames: frame numbers.
        rows: rows of the frame.
        matte: [T, rows, W].
        fixed: [T, rows, W], True where the value is a neighbour's and is not solved.
    """

    frames: tuple[int, ...]
    rows: slice
    matte: Mask | PackedMasks
    fixed: Mask | PackedMasks

    def pixels(self, index: int, frame: Float32) -> Float32:
        """Matte pixels [C, n] of a whole frame [C, H, W] at a position of the window."""
        return frame[:, self.rows][:, self.matte[index]]


def solve_window(space: Space, window: Window, start: Float32 | None) -> tuple[Float32, dict[str, Any]]:
    """Solves a window's free pixels.

    Args:
        space: of the task.
        window: what is loaded.
        start: [2, N] values of the matte pixels to start from; None: what was observed.

    Returns:
        The value [2, N], and facts: iterations, certified relative gap, pixels, rows.
    """
    temporal, params, gaps = space.job.shot.temporal, of.energy_params(space.job.shot), space.task.gaps
    data = listed(window, lambda frame: observed(space, gaps, frame))
    confidence = listed(window, lambda frame: space.read(CONFIDENCE, "confidence", frame))
    links = Links(space, window)
    with space.kernel():  # it reads links as it goes; those are not counted
        geometry = build_geometry(window.matte, Part(links, 0), Part(links, 1), window.fixed)
        _drop_spatial_terms(geometry, space, window)
    lists = BlockLists(geometry, data, confidence, data if start is None else start)
    release_memory()  # the frames that were read are cut to lists now
    with space.kernel():
        value, stats = solve_lists(lists, params, STEP * temporal.tolerance, temporal.method)
    facts = {"iterations": stats.iterations, "gap": stats.gap, "pixels": stats.pixels, "rows": window.matte.shape[1]}
    return value, facts | ({"cut_links": links.cut} if links.cut else {})


def _drop_spatial_terms(geometry: Geometry, space: Space, window: Window) -> None:
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
        parts.append(np.ascontiguousarray(part))
    return np.concatenate(parts, axis=1)


def known(space: Space, frame: int, bands: Iterable[int], sweep: int) -> Float32:
    """A frame as the sweeps before this one left it: [2, H, W], 0 in rows of bands that are not asked for."""
    exchange = space.task.exchange
    stages = exchange.before(exchange.blocks.index_of(space.job.position(frame)), bands, sweep)
    if exchange.chunks.whole:
        return space.read(stages[0], "material", frame)
    whole = np.zeros((2, space.job.height, space.job.width), np.float32)
    for index, stage in stages.items():
        rows, values = space.task.bands[index].core.slice, space.read(stage, "material", frame)
        whole[:, rows] = values[:, rows] if values.shape[1] == space.job.height else values
    return whole


def keep(space: Space, frame: int, facts: dict[str, Any], band: int | None) -> None:
    """Commits a frame as the sweep before left it: by a hard link where shapes agree, else by a copy.

    Args:
        space: of the task.
        frame: frame number.
        facts: for the record.
        band: number of the band that is committed; None: whole frames.
    """
    exchange, bands = space.task.exchange, space.task.bands
    asked = range(len(bands)) if band is None else (band,)
    chunk = exchange.blocks.index_of(space.job.position(frame))
    held = exchange.before(chunk, asked, space.task.sweep)
    if len(bands) == 1 or (band is not None and held[band].band is not None):
        space.carry(frame, "material", held[band or 0], facts)
        return
    rows = slice(None) if band is None else bands[band].core.slice
    space.commit(frame, {"material": known(space, frame, asked, space.task.sweep)[:, rows]}, facts=facts)


class Links:
    """Flow [rows, W, 2] and validity [rows, W] of a window, read pair by pair; a pair without flow has validity 0.

    Attributes:
        inconsistent: frames of the window whose own data are not used (tasks/confidence.py).
        cut: links that are longer than a band can follow, and were cut.
    """

    def __init__(self, space: Space, window: Window) -> None:
        self._space, self._window = space, window
        self._limit = space.task.exchange.chunks.reach or np.inf
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
        if frame in space.task.gaps.unlinked:
            return np.zeros((*shape, 2), np.float32), np.zeros(shape, np.float32)
        flow = space.read(FLOW, "flow", frame)[:, window.rows].transpose(1, 2, 0)
        validity = space.read(FLOW, "validity", frame)[0, window.rows].copy()
        # Bands must agree on the energy, so a link that one of them cannot follow is cut in all.
        long = (np.abs(flow[..., 1]) > self._limit - 1) & (validity > 0) & window.matte[index]
        self.cut += int(long.sum())
        validity[long] = 0
        if frame in self.inconsistent or window.frames[index + 1] in self.inconsistent:
            validity = bridge(validity)
        return flow, validity


def _inconsistent(space: Space, frame: int) -> bool:
    """Whether a frame as a whole contradicts its neighbours (tasks/confidence.py)."""
    record = space.book.find(CONFIDENCE, frame)
    return record is not None and frame in record.facts.get("inconsistent", [])


@dataclass(frozen=True)
class Part:
    """Flow (half 0) or validity (half 1) of the links, as `build_geometry` reads them."""

    links: Links
    half: int

    def __getitem__(self, index: int) -> Float32:
        return self.links.pair(index)[self.half]
