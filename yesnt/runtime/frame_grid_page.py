"""The scheduler's side of the frame grid: a page that only reads, beside Dask's own dashboard.

The driver sends the state of its job about once a second; the page asks the scheduler for it. A scheduler that serves
several jobs shows each of them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from distributed import SchedulerPlugin
from tornado.web import RequestHandler

PAGE = "yesnt"
"""Path of the page on the dashboard's address."""

MAX_JOBS = 16
"""Jobs that the page remembers; beyond that, the one that was silent longest is forgotten."""


@dataclass(frozen=True)
class JobState:
    """What a driver has sent.

    Attributes:
        grid: `FrameGrid.summary`.
        picture: the newest composite as JPEG; b"" before the first.
        time: when it came, seconds of a monotonic clock.
    """

    grid: Mapping[str, Any]
    picture: bytes
    time: float


class FrameGridPage(SchedulerPlugin):
    """Adds the page to the scheduler's HTTP server and takes what drivers send.

    Args:
        html: the page.
    """

    name = "yesnt-frame-grid"
    idempotent = True

    def __init__(self, html: str) -> None:
        self._html = html
        self._jobs: dict[str, JobState] = {}
        self._viewed: float | None = None

    def start(self, scheduler: Any) -> None:
        """Called by the scheduler once it has the plugin."""
        scheduler.handlers["yesnt_frame_grid"] = self.take
        scheduler.http_application.add_handlers(
            ".*$",
            [
                (f"/{PAGE}", _Page, {"html": self._html}),
                (f"/{PAGE}/state.json", _State, {"page": self}),
                (f"/{PAGE}/preview.jpg", _Picture, {"page": self}),
            ],
        )

    def take(self, job: str = "", grid: Mapping[str, Any] | None = None, picture: bytes = b"") -> dict[str, Any]:
        """Takes the state of a job from its driver; without a new picture the last one stays.

        Returns:
            `viewed`: seconds since somebody looked at the page, or None.
        """
        old = self._jobs.pop(job, None)
        if old is not None and not picture:
            picture = old.picture
        self._jobs[job] = JobState(grid or {}, picture, time.monotonic())
        while len(self._jobs) > MAX_JOBS:
            del self._jobs[min(self._jobs, key=lambda name: self._jobs[name].time)]
        viewed = None if self._viewed is None else time.monotonic() - self._viewed
        return {"viewed": viewed}

    def look(self) -> dict[str, Any]:
        """What the page shows: the jobs, the one that reported last first."""
        self._viewed = time.monotonic()
        jobs = sorted(self._jobs.items(), key=lambda item: -item[1].time)
        return {
            "jobs": [
                {"name": name, "age": self._viewed - state.time, "picture": bool(state.picture), **state.grid}
                for name, state in jobs
            ]
        }

    def picture(self, job: str) -> bytes:
        """The newest picture of a job as JPEG; b"" if there is none."""
        state = self._jobs.get(job)
        return b"" if state is None else state.picture


class _Fresh(RequestHandler):
    """A handler whose answers no browser keeps."""

    def set_default_headers(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")


class _Page(_Fresh):
    def initialize(self, html: str) -> None:
        self._html = html

    def get(self) -> None:
        self.write(self._html)


class _State(_Fresh):
    def initialize(self, page: FrameGridPage) -> None:
        self._page = page

    def get(self) -> None:
        self.write(self._page.look())


class _Picture(_Fresh):
    def initialize(self, page: FrameGridPage) -> None:
        self._page = page

    def get(self) -> None:
        data = self._page.picture(self.get_query_argument("job", ""))
        self.set_status(200 if data else 404)
        self.set_header("Content-Type", "image/jpeg")
        self.write(data)
