"""A film and a contact sheet for the eye: sRGB from the delivered EXRs, made again only when they change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.color import srgb_encode
from yesnt.io.durable import durable_path
from yesnt.io.exr import read_image

FRAMES_PER_SECOND = 24
SHEET_COLUMNS, SHEET_CELLS, SHEET_CELL_WIDTH = 8, 16, 192


def write_preview(exrs: Sequence[Path], folder: Path) -> tuple[Path, Path]:
    """Writes `preview.mp4` and `contact_sheet.png` from the composites in a sequence of EXRs.

    One frame is in memory at a time, whatever the length of the shot.
    """
    film, sheet = folder / "preview.mp4", folder / "contact_sheet.png"
    stride = max(1, -(-len(exrs) // SHEET_CELLS))
    cells: list[NDArray[np.uint8]] = []
    with durable_path(film) as temporary:
        import av

        with av.open(str(temporary), "w", format="mp4", options={"fflags": "+bitexact"}) as container:
            stream = None
            for i, path in enumerate(exrs):
                picture = _display(path)
                if stream is None:
                    stream = container.add_stream("libx264", rate=FRAMES_PER_SECOND)
                    stream.height, stream.width = picture.shape[:2]
                    stream.pix_fmt = "yuv420p"
                    # One thread and bit-exact flags: equal pictures give equal bytes.
                    stream.options = {"crf": "18", "threads": "1", "x264-params": "threads=1"}
                    stream.codec_context.flags |= av.codec.context.Flags.bitexact
                for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                    container.mux(packet)
                if i % stride == 0:
                    cells.append(_shrink(picture))
            if stream is not None:
                for packet in stream.encode():
                    container.mux(packet)
    _write_sheet(sheet, cells)
    return film, sheet


def _display(path: Path) -> NDArray[np.uint8]:
    """The composite as sRGB bytes, cropped to even sides (4:2:0 needs them)."""
    color = read_image(path).stack("RGB")
    picture = (srgb_encode(color) * 255 + 0.5).astype(np.uint8)
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
    return np.ascontiguousarray(picture[: max(height, 1), : max(width, 1)])


def _shrink(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    height = max(1, round(picture.shape[0] * SHEET_CELL_WIDTH / picture.shape[1]))
    return np.asarray(cv2.resize(picture, (SHEET_CELL_WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)


def _write_sheet(path: Path, cells: Sequence[NDArray[np.uint8]]) -> None:
    import cv2

    columns = min(SHEET_COLUMNS, len(cells))
    rows = -(-len(cells) // columns)
    height, width = cells[0].shape[:2]
    sheet = np.zeros((rows * height, columns * width, 3), np.uint8)
    for i, cell in enumerate(cells):
        y, x = i // columns * height, i % columns * width
        sheet[y : y + height, x : x + width] = cell
    _, data = cv2.imencode(".png", sheet[..., ::-1])
    with durable_path(path) as temporary:
        temporary.write_bytes(data.tobytes())
