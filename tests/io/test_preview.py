"""The preview video: segments are joined without loss, in order, with the same bytes each time."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from yesnt.io.exr import write_exr
from yesnt.io.preview import SEGMENT_FRAMES, SHEET_CELL_WIDTH, SHEET_CELLS, join_segments, write_segment

LENGTH = 2 * SEGMENT_FRAMES + 5


@pytest.fixture(scope="module")
def exrs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Frames that grow brighter: a frame out of place would be seen."""
    folder, paths = tmp_path_factory.mktemp("exrs"), []
    for i in range(LENGTH):
        paths.append(folder / f"f.{i:04d}.exr")
        write_exr(paths[-1], {c: np.full((33, 48), (i + 1) / LENGTH, np.float16) for c in "RGB"})
    return paths


def make(folder: Path, exrs: list[Path], length: int) -> tuple[Path, Path]:
    folder.mkdir()
    segments, strips = [], []
    for first in range(0, len(exrs), length):
        segments.append(folder / f"{first}.mp4")
        strips.append(folder / f"{first}.png")
        write_segment(exrs[first : first + length], segments[-1], strips[-1])
    video, sheet = folder / "video.mp4", folder / "sheet.png"
    join_segments(segments, strips, video, sheet)
    return video, sheet


def luminance(video: Path) -> tuple[list[float], list[float]]:
    with av.open(str(video)) as source:
        frames = [(float(f.time), float(f.to_ndarray(format="gray").mean())) for f in source.decode(video=0)]
    return [t for t, _ in frames], [y for _, y in frames]


def test_segments_become_one_video_in_order(exrs: list[Path], tmp_path: Path) -> None:
    times, values = luminance(make(tmp_path / "a", exrs, SEGMENT_FRAMES)[0])
    _, whole = luminance(make(tmp_path / "b", exrs, LENGTH)[0])
    np.testing.assert_allclose(times, np.arange(LENGTH) / 24, atol=1e-3)
    np.testing.assert_allclose(values, whole, atol=1.5)  # one grey level of a lossy code
    assert np.all(np.diff(values) > -1)
    assert values[-1] - values[0] > 150


def test_the_sheet_does_not_depend_on_segments(exrs: list[Path], tmp_path: Path) -> None:
    sheets = [make(tmp_path / str(n), exrs, n)[1].read_bytes() for n in (SEGMENT_FRAMES, LENGTH)]
    assert sheets[0] == sheets[1]
    picture = cv2.imread(str(tmp_path / str(SEGMENT_FRAMES) / "sheet.png"))
    cells = [picture[:, x : x + SHEET_CELL_WIDTH] for x in range(0, picture.shape[1], SHEET_CELL_WIDTH)]
    assert len(cells) * (picture.shape[0] // 128) <= SHEET_CELLS
    assert np.all(np.diff([cell[:128].mean() for cell in cells]) > 0)


def test_the_same_pictures_give_the_same_video(exrs: list[Path], tmp_path: Path) -> None:
    videos = set()
    for number in range(20):
        _ = [bytearray(number.to_bytes() * size) for size in (1_000, 50_000, 2_000_000)]  # other leftovers in memory
        videos.add(make(tmp_path / str(number), exrs, SEGMENT_FRAMES)[0].read_bytes())
    assert len(videos) == 1
