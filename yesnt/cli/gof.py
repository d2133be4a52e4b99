"""`yesnt gof`: pictures and meshes of Gaussian opacity fields."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from yesnt.cli import text
from yesnt.core.errors import UsageError

if TYPE_CHECKING:
    from yesnt.runtime.session import Session

ORBIT = "orbit"


class GofAction(StrEnum):
    """What `yesnt gof` does."""

    fit = "fit"
    render = "render"
    mesh = "mesh"

    @property
    def stage(self) -> str:
        """The stage that does it."""
        return {"fit": "fit", "render": "view", "mesh": "mesh"}[self.value]


@dataclass(frozen=True)
class CameraPath:
    """Another camera than the shot's.

    Attributes:
        stops: names of cameras of the capture that it passes; none: once around, from the shot's camera.
        views: pictures along the path.
        out: folder of the pictures.
    """

    stops: tuple[str, ...]
    views: int
    out: Path


def path_of(action: GofAction, path: str | None, views: int, out: Path | None) -> CameraPath | None:
    """The camera path that the options ask for, if they do.

    Raises:
        UsageError: options that do not go together.
    """
    if path is None and out is None:
        return None
    if path is None or out is None or action is not GofAction.render:
        raise UsageError(
            "A camera path needs a folder, and is only rendered", "yesnt gof", "`render SHOT --path orbit --out DIR`",
            "give both options, with `render`",
        )  # fmt: skip
    stops = () if path == ORBIT else tuple(name.strip() for name in path.split(","))
    if len(stops) == 1:
        raise UsageError(
            f"The path {path!r} has one camera", "--path", "`orbit`, or two or more names with commas", "name another"
        )
    return CameraPath(stops, views, out)


def render_path(session: Session, along: CameraPath, frames: str | None, json: bool) -> int:
    """Renders one moment of a shot along a path: `view.####.exr` from 1 on, and their `camera.json`."""
    from yesnt.cli.file_progress import FileProgress
    from yesnt.inspect.field_views import render_views
    from yesnt.runtime.run_options import wanted_frames

    moment = wanted_frames(session.job, frames)
    if len(moment) > 1 and frames is not None:
        raise UsageError(
            f"A camera path shows one moment, and {len(moment)} are asked for", f"--frames {frames}", "one frame",
            "name one",
        )  # fmt: skip
    files = render_views(session, moment[0], along.stops, along.views, along.out, FileProgress())
    if json:
        text.print_json(
            {"frame": moment[0], "camera": str(along.out / "camera.json"), "files": [str(f) for f in files]}
        )
    else:
        print(f"Wrote {len(files)} views of frame {moment[0]} and camera.json to {along.out}")
    return 0
