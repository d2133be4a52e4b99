"""Tasks of the preview: segments of a video, then the video and the contact sheet of the shot."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from yesnt.io.color_config import convert
from yesnt.io.file_digests import file_digest
from yesnt.io.preview import Presentation, join_segments, write_segment
from yesnt.planning.stages import SEGMENT
from yesnt.planning.task_records import PreviewSegmentTask, PreviewTask
from yesnt.tasks.workspace import Workspace


def encode_segment(space: Workspace[PreviewSegmentTask]) -> None:
    """Encodes a segment of the video from its frames' EXRs."""
    output = space.output
    files = output.segment_paths(SEGMENT, space.node.index)
    files[0].parent.mkdir(parents=True, exist_ok=True)
    exrs = [output.exr_path(space.job.shot.name, frame) for frame in space.task.frames]
    write_segment(exrs, *files, partial(convert, conversion=space.job.colors.display), Presentation.of(space.job))
    _commit(space, files)


def join_preview(space: Workspace[PreviewTask]) -> None:
    """Joins all segments to `preview.mp4` and `contact_sheet.png`."""
    output = space.output
    pairs = (output.segment_paths(SEGMENT, number) for number in range(space.task.segments))
    segments, strips = zip(*pairs, strict=True)
    files = output.run / "preview.mp4", output.run / "contact_sheet.png"
    join_segments(segments, strips, *files, Presentation.of(space.job))
    _commit(space, files)


def _commit(space: Workspace[Any], files: tuple[Path, ...]) -> None:
    space.commit(space.frame, {}, {str(path.relative_to(space.output.root)): file_digest(path) for path in files})
