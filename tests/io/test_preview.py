"""The preview video: segments are joined without loss, in order, with the same bytes each time."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from yesnt.core.windows import Window
from yesnt.io.exr import write_exr
from yesnt.io.preview import SEGMENT_FRAMES, SHEET_CELL_WIDTH, SHEET_CELLS, Presentation, join_segments, write_segment

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


def test_rate_window_and_pixels_are_the_plates(tmp_path: Path) -> None:
    exrs = []
    for i in range(4):
        plane = np.zeros((10, 24), np.float16)
        plane[1:9, 2:22] = 0.5 + 0.1 * i
        exrs.append(tmp_path / f"{i}.exr")
        write_exr(exrs[-1], dict.fromkeys("RGB", plane))
    how = Presentation(Window(2, 1, 20, 8), 2.0, Fraction(30000, 1001))
    segments, strips = zip(*((tmp_path / f"{i}.mp4", tmp_path / f"{i}.png") for i in (0, 1)), strict=True)
    for i, (segment, strip) in enumerate(zip(segments, strips, strict=True)):
        write_segment(exrs[2 * i : 2 * i + 2], segment, strip, how=how)
    video = tmp_path / "v.mp4"
    join_segments(segments, strips, video, tmp_path / "s.png", how)
    with av.open(str(video)) as source:
        frames = list(source.decode(video=0))
        assert source.streams.video[0].average_rate == Fraction(30000, 1001)
    assert [(f.width, f.height) for f in frames] == [(40, 8)] * 4
    np.testing.assert_allclose([f.time for f in frames], np.arange(4) * 1001 / 30000, atol=1e-4)
    assert frames[0].to_ndarray(format="gray").min() > 150, "nothing outside the window is shown"


@pytest.mark.parametrize(("aspect", "size"), [(2.0, (40, 10)), (0.5, (20, 20)), (1.0, (20, 10))])
def test_pixels_are_made_square_without_loss(aspect: float, size: tuple[int, int]) -> None:
    assert Presentation(aspect=aspect).square(20, 10) == size
