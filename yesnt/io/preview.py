"""Preview video and contact sheet of a shot, in sRGB, from the delivered EXRs.

The video is encoded in segments of one second as frames are delivered; the segments are then joined without encoding
them again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.core.shot import Job
from yesnt.core.windows import Window
from yesnt.io.durable import durable_path
from yesnt.io.exr import read_planes

Display = Callable[[NDArray[np.float32]], NDArray[np.floating]]

FRAMES_PER_SECOND = 24
"""Of shots whose plates do not say."""

SEGMENT_FRAMES = 24
"""Frames of a video segment of such a shot, one second; also the distance of the video's key frames."""

LEAST_SIDE = 2
"""Columns and rows of the smallest picture that 4:2:0 can hold."""

SHEET_COLUMNS, SHEET_CELLS, SHEET_CELL_WIDTH = 8, 16, 192


@dataclass(frozen=True)
class Presentation:
    """How delivered pictures are shown.

    Attributes:
        shown: what is shown of a delivered picture, counted from its corner: the display window; None: all.
        aspect: width of a pixel over its height; pictures are stretched to square pixels.
        rate: frames per second.
    """

    shown: Window | None = None
    aspect: float = 1.0
    rate: Fraction = Fraction(FRAMES_PER_SECOND)

    @classmethod
    def of(cls, job: Job) -> Presentation:
        """The display window, the pixels and the frame rate of a job's plates."""
        raster = job.raster
        if raster is None:
            return cls()
        shown = raster.display.moved(-raster.processed.left, -raster.processed.top)
        rate = Fraction(*raster.rate) if raster.rate else Fraction(FRAMES_PER_SECOND)
        return cls(None if raster.display == raster.processed else shown, raster.aspect, rate)

    @property
    def segment_frames(self) -> int:
        """Frames of a video segment, about one second."""
        return max(1, round(self.rate))

    def square(self, width: int, height: int) -> tuple[int, int]:
        """Columns and rows of a picture of square pixels: neither is less than those that are shown."""
        return (round(width * self.aspect), height) if self.aspect >= 1 else (width, round(height / self.aspect))


USUAL = Presentation()
"""All of a picture, square pixels, 24 frames per second."""


def has_video(job: Job) -> bool:
    """Whether a job's pictures can be coded: 4:2:0 needs two columns and two rows."""
    return min(job.display_size) >= LEAST_SIDE


def write_segment(
    exrs: Sequence[Path], video: Path, strip: Path, show: Display = srgb_encode, how: Presentation = USUAL
) -> None:
    """Encodes the composites of some frames as a video, and writes them side by side, reduced, as a PNG strip.

    One frame is in memory at a time.

    Args:
        exrs: delivered EXRs in order.
        video: the mp4 to write.
        strip: the PNG to write, one cell of `SHEET_CELL_WIDTH` pixels a frame.
        show: delivered colour [H, W, 3] to code values of an sRGB display in [0, 1].
        how: window, pixels and rate.
    """
    cells: list[NDArray[np.uint8]] = []
    with _video(video) as container:
        stream = None
        for path in exrs:
            picture = _display(path, show, how)
            if stream is None:
                stream = _coded_stream(container, picture, how.rate)
            _mux(container, stream, picture)
            cells.append(_shrink(picture))
        if stream is not None:
            container.mux(stream.encode())
    _write_png(strip, np.concatenate(cells, axis=1))


def join_segments(
    segments: Sequence[Path], strips: Sequence[Path], video: Path, sheet: Path, how: Presentation = USUAL
) -> None:
    """Joins video segments in order, without encoding them again, and makes a contact sheet of their strips."""
    import av

    first, target = 0, None
    with _video(video) as container:
        for segment in segments:
            with av.open(str(segment)) as source:
                stream = source.streams.video[0]
                target = target or container.add_stream_from_template(stream)
                frames = 0
                for packet in source.demux(stream):
                    if packet.dts is None:  # the end of the file
                        continue
                    frames += 1
                    _shift(packet, first, how.rate)
                    packet.stream = target
                    container.mux(packet)
            first += frames
    _write_png(sheet, _sheet(strips, first))


@contextmanager
def _video(path: Path) -> Iterator[Any]:
    """An mp4 that is written whole or not at all; equal pictures give equal bytes."""
    import av

    with (
        durable_path(path) as temporary,
        av.open(str(temporary), "w", format="mp4", options={"fflags": "+bitexact"}) as container,
    ):
        yield container


def _coded_stream(container: Any, picture: NDArray[np.uint8], rate: Fraction) -> Any:
    import av

    stream = container.add_stream("libx264", rate=rate)
    stream.height, stream.width = picture.shape[:2]
    stream.pix_fmt = "yuv420p"
    _tag(stream.codec_context)
    # With x264's macroblock tree, bytes differ from run to run where vectors are wide: 1 video in 3 under load.
    stream.options = {"crf": "18", "threads": "1", "x264-params": "threads=1:no-mbtree=1"}
    stream.codec_context.flags |= av.codec.context.Flags.bitexact
    return stream


def _tag(coded: Any) -> None:
    """Says what the numbers mean, for players: matrix and primaries of BT.709, limited range, and the sRGB curve.

    A video without tags is decoded by BT.601 or BT.709 as its height suggests, which changes saturated colours.
    """
    from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc

    coded.colorspace, coded.color_primaries = Colorspace.ITU709, ColorPrimaries.BT709
    coded.color_trc, coded.color_range = ColorTrc.IEC61966_2_1, ColorRange.MPEG


def _mux(container: Any, stream: Any, picture: NDArray[np.uint8]) -> None:
    """Encodes a picture; FFmpeg's own conversion would take the matrix of BT.601."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
        format="yuv420p",
        src_colorspace=Colorspace.ITU709, dst_colorspace=Colorspace.ITU709,
        src_color_range=ColorRange.JPEG, dst_color_range=ColorRange.MPEG,
    )  # fmt: skip
    container.mux(stream.encode(frame))


def _shift(packet: Any, frames: int, rate: Fraction) -> None:
    """Moves the time stamps of a segment's packet to its place in the whole video."""
    ticks = round(frames / (rate * packet.time_base))
    packet.pts += ticks
    packet.dts += ticks


def _display(path: Path, show: Display, how: Presentation) -> NDArray[np.uint8]:
    """The composite as display code values, cropped to even sides (4:2:0 needs them)."""
    planes = read_planes(path)
    color = np.stack([planes[name] for name in "RGB"], axis=-1).astype(np.float32)
    if how.shown is not None:
        color = color[how.shown.top : how.shown.bottom, how.shown.left : how.shown.right]
    picture = (np.clip(show(color), 0, 1) * 255 + 0.5).astype(np.uint8)
    if how.aspect != 1:
        picture = _stretched(picture, how)
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
    return np.ascontiguousarray(picture[: max(height, 1), : max(width, 1)])


def _stretched(picture: NDArray[np.uint8], how: Presentation) -> NDArray[np.uint8]:
    import cv2

    height, width = picture.shape[:2]
    return np.asarray(cv2.resize(picture, how.square(width, height), interpolation=cv2.INTER_LINEAR), np.uint8)


def _shrink(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    height = max(1, round(picture.shape[0] * SHEET_CELL_WIDTH / picture.shape[1]))
    return np.asarray(cv2.resize(picture, (SHEET_CELL_WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


def _sheet(strips: Sequence[Path], length: int) -> NDArray[np.uint8]:
    """A few frames of all strips, evenly chosen, in rows."""
    chosen = range(0, length, max(1, -(-length // SHEET_CELLS)))
    cells = [cell for i, cell in enumerate(_cells(strips)) if i in chosen]
    columns = min(SHEET_COLUMNS, len(cells))
    height, width = cells[0].shape[:2]
    sheet = np.zeros((-(-len(cells) // columns) * height, columns * width, 3), np.uint8)
    for i, cell in enumerate(cells):
        y, x = i // columns * height, i % columns * width
        sheet[y : y + height, x : x + width] = cell
    return sheet


def _cells(strips: Sequence[Path]) -> Iterator[NDArray[np.uint8]]:
    import cv2

    for path in strips:
        strip = np.asarray(cv2.imread(str(path)), np.uint8)[..., ::-1]
        for x in range(0, strip.shape[1], SHEET_CELL_WIDTH):
            yield strip[:, x : x + SHEET_CELL_WIDTH]


def _write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    import cv2

    _, data = cv2.imencode(".png", picture[..., ::-1])
    with durable_path(path) as temporary:
        temporary.write_bytes(data.tobytes())


def thumbnail(exr: Path, show: Display = srgb_encode, how: Presentation = USUAL) -> bytes:
    """The composite of a delivered EXR as a small JPEG, for pages that show a run's progress; see `write_segment`."""
    import cv2

    _, data = cv2.imencode(".jpg", _shrink(_display(exr, show, how))[..., ::-1])
    return bytes(data)
