"""Frame-exact pictures of a video: found by their time stamps, which are all read before the first picture.

A picture is never counted from where a seek happened to land. A video whose pictures are not evenly spaced is refused,
since a number would then not say when a picture was taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError

F32 = NDArray[np.float32]

SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mxf", ".mts", ".m2ts", ".ts")

MATRICES = {
    1: (0.2126, 0.0722), 4: (0.30, 0.11), 5: (0.299, 0.114), 6: (0.299, 0.114), 7: (0.212, 0.087),
    9: (0.2627, 0.0593), 10: (0.2627, 0.0593),
}  # fmt: skip
"""Weights of red and blue in luma, by the number of ITU-T H.273: BT.709, FCC, BT.601 (twice), SMPTE 240M, BT.2020."""

FULL_RANGE = 2
"""FFmpeg's number of a video whose luma runs from 0 to 255; others from 16 to 235."""

HD_ROWS = 720
"""Rows from which a video that names no matrix is taken to use that of BT.709; smaller ones that of BT.601."""

_EVEN = 0.5  # of a frame, by which a time stamp may be off its place
_EXPECTED = "a video at a constant frame rate"


@dataclass(frozen=True)
class VideoIndex:
    """When each picture of a video is shown.

    Attributes:
        width, height: columns and rows, as shown upright.
        rate: frames per second.
        stamps: time stamp of every picture in the order in which they are shown, units of the stream's time base.
    """

    width: int
    height: int
    rate: Fraction
    stamps: tuple[int, ...]


def is_video(path: Path) -> bool:
    """Whether a file's name is that of a video."""
    return path.suffix.lower() in SUFFIXES


def video_index(path: Path) -> VideoIndex:
    """The index of a video, without decoding more than its first picture.

    Raises:
        JobError: the file is missing, is no video, or its pictures are not evenly spaced.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise JobError("The video is missing", str(path), "a video of a camera", "check the path") from error
    return _index(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _index(path: Path, _modified: int, _size: int) -> VideoIndex:
    with _opened(path) as (container, stream):
        stamps = sorted(packet.pts for packet in container.demux(stream) if packet.pts is not None)
        if not stamps:
            raise JobError("The video has no pictures", str(path), _EXPECTED, "export it again")
        rate = _even_rate(path, np.array(stamps), stream.time_base, stream.average_rate)
    with _opened(path) as (container, stream):
        first = next(container.decode(stream))
        quarter = bool(_turns(first) % 2)
        size = (first.height, first.width) if quarter else (first.width, first.height)
        if getattr(first, "interlaced_frame", False):
            raise JobError("The video is interlaced", str(path), "whole pictures", "deinterlace it")
    return VideoIndex(*size, rate, tuple(stamps))


def _even_rate(path: Path, stamps: NDArray[np.int64], base: Fraction, stated: Fraction | None) -> Fraction:
    """Frames per second of evenly spaced pictures; of a single one what the file states."""
    steps = np.diff(stamps)
    if not len(steps):
        return Fraction(stated or 1)
    gaps = steps / max(float(np.median(steps)), 1e-9)
    odd = np.flatnonzero(np.abs(gaps - 1) > _EVEN)
    rate = len(steps) / (int(steps.sum()) * Fraction(base))
    if len(odd):
        raise JobError(
            f"The video's pictures are not evenly spaced: after picture {odd[0] + 1} of {len(stamps)} the next comes "
            f"{gaps[odd[0]]:.2g} frames later",
            str(path), _EXPECTED,
            "convert it (`ffmpeg -i IN -fps_mode cfr OUT` repeats dropped pictures), or export pictures",
        )  # fmt: skip
    return rate


def read_pictures(path: Path, positions: Sequence[int]) -> Iterator[F32]:
    """Pictures of a video by position (0 is the first), ascending: [H, W, 3] in [0, 1], encoded as the video is.

    Only one picture is held at a time.

    Raises:
        JobError: the video cannot be read, or has no such picture.
    """
    index = video_index(path)
    beyond = [p for p in positions if not 0 <= p < len(index.stamps)]
    if beyond:
        raise JobError(
            f"The video has no picture {beyond[0] + 1}", str(path), f"pictures 1 to {len(index.stamps)}",
            "check `frames`, `capture.first` and `capture.offsets`",
        )  # fmt: skip
    wanted = sorted(set(positions))
    with _opened(path) as (container, stream):
        if wanted:
            container.seek(index.stamps[wanted[0]], stream=stream, backward=True)
        pictures = container.decode(stream)
        for position in wanted:
            found = next((p for p in pictures if p.pts is not None and p.pts >= index.stamps[position]), None)
            if found is None or found.pts != index.stamps[position]:
                raise JobError(
                    f"Picture {position + 1} of the video cannot be decoded",
                    str(path),
                    "an intact video",
                    "copy it again",
                )
            yield _encoded(found)


def read_picture(path: Path, position: int) -> F32:
    """One picture of a video; see `read_pictures`."""
    return next(read_pictures(path, (position,)))


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    import av

    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise JobError("The file has no video", str(path), "a video of a camera", "check the file")
            yield container, container.streams.video[0]
    except av.FFmpegError as error:
        raise JobError(f"The video cannot be read ({error})", str(path), "a video", "check the file") from error


def _encoded(picture: Any) -> F32:
    """Red, green, blue in [0, 1] of a decoded picture, upright.

    The matrix is applied here: swscale's fast conversion is up to three levels of 255 too dark.
    """
    if picture.format.is_rgb:
        rgb = picture.reformat(format="gbrpf32le").to_ndarray()
        return np.ascontiguousarray(np.rot90(rgb, _turns(picture)), np.float32)
    deep = max(component.bits for component in picture.format.components) > 8
    planes = picture.reformat(format="yuv444p16le" if deep else "yuv444p").to_ndarray().astype(np.float32)
    y, blue, red = planes / np.float32(256 if deep else 1)
    if picture.color_range == FULL_RANGE or picture.format.name.startswith("yuvj"):
        y, blue, red = y / 255, (blue - 128) / 255, (red - 128) / 255
    else:
        y, blue, red = (y - 16) / 219, (blue - 128) / 224, (red - 128) / 224
    default = 1 if picture.height >= HD_ROWS else 5
    kr, kb = MATRICES.get(int(picture.colorspace), MATRICES[default])
    r, b = y + 2 * (1 - kr) * red, y + 2 * (1 - kb) * blue
    g = (y - kr * r - kb * b) / (1 - kr - kb)
    rgb = np.clip(np.stack([r, g, b], axis=-1), 0, 1)
    return np.ascontiguousarray(np.rot90(rgb, _turns(picture)), np.float32)


def _turns(picture: Any) -> int:
    """Quarter turns counter-clockwise that set a picture upright, as phones store them."""
    return round(float(getattr(picture, "rotation", 0) or 0) / 90) % 4
