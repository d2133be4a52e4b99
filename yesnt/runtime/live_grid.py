"""The driver's side of the frame grid: follows the run and sends its state to the scheduler, which shows it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from yesnt.planning.frame_grid import FrameGrid
from yesnt.planning.graph import Graph, NodeId

SEND_SECONDS = 1.0
PICTURE_SECONDS = 3.0
"""A new picture is sent at most this often, and only while somebody looks at the page."""

LOOKING_SECONDS = 10.0
"""Somebody looks at the page if it was asked for in this time."""

HTML = Path(__file__).parents[1] / "data" / "frame_grid.html"


def frame_grid_of(dashboard: str) -> str:
    """Address of the frame grid beside Dask's dashboard (`http://HOST:PORT/status`); "" where there is none."""
    return f"{dashboard.removesuffix('status')}yesnt" if dashboard else ""


class LiveGrid:
    """State of a run, which may be watched on the dashboard.

    Args:
        name: of the job, as the page shows it.
        grid: the state.
        picture: makes the JPEG of a delivered frame.
    """

    def __init__(self, name: str, grid: FrameGrid, picture: Callable[[int], bytes]) -> None:
        self._name, self._grid, self._picture = name, grid, picture
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None

    def lay_out(self, graph: Graph, done: Iterable[NodeId]) -> None:
        """Begins a pass over a graph; see `FrameGrid.lay_out`."""
        with self._lock:
            self._grid.lay_out(graph, done)

    def apply(self, event: Mapping[str, Any]) -> None:
        """Takes one event of the driver."""
        with self._lock:
            self._grid.apply(event)

    def published(self, client: Any) -> Any:
        """Puts the page on the scheduler's dashboard and keeps it up to date until `close`; returns the client.

        A scheduler that cannot show it (it has no dashboard, or no yesnt) does without.
        """
        if self._thread is not None:
            return client
        from yesnt.runtime.frame_grid_page import FrameGridPage

        with suppress(Exception):  # what a scheduler raises depends on what it lacks
            client.register_plugin(FrameGridPage(HTML.read_text(encoding="utf-8")))
            self._thread = threading.Thread(target=self._send_until_closed, args=(client,), daemon=True)
            self._thread.start()
        return client

    def close(self) -> None:
        """Sends the last state and ends; waits a moment at most, since the scheduler may be gone."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=2 * SEND_SECONDS)

    def _send_until_closed(self, client: Any) -> None:
        shown, waited, looking = None, 0.0, False
        with suppress(Exception):  # the driver reports a lost scheduler; a page is no reason to end a run
            last = False
            while not last:
                last = self._stop.wait(SEND_SECONDS)
                waited += SEND_SECONDS
                with self._lock:
                    state, newest = self._grid.summary(), self._grid.newest
                picture = b""
                if newest not in (None, shown) and (last or (looking and waited >= PICTURE_SECONDS)):
                    picture, shown, waited = self._picture(newest), newest, 0.0
                reply = client.sync(client.scheduler.yesnt_frame_grid, job=self._name, grid=state, picture=picture)
                looking = reply["viewed"] is not None and reply["viewed"] < LOOKING_SECONDS
