"""The preview video: its colours in a player, and a picture too small for a video."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import ColorTrc

from tests.cases.shots import FRAME, check, write, write_shot
from tests.in_process import run_here
from yesnt.io import preview
from yesnt.runtime.session import Session

BARS = {"red": (1, 0, 0), "green": (0, 1, 0), "magenta": (1, 0, 1)}
WIDTH, HEIGHT = 1280, 720


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of one HD frame of three colour bars."""
    folder = tmp_path_factory.mktemp("video")
    picture = np.repeat(np.array(list(BARS.values()), np.float16), (427, 427, 426), axis=0)
    planes = {c: np.broadcast_to(picture[:, i], (HEIGHT, WIDTH)) for i, c in enumerate("RGB")}
    write(folder / "hd.exr", planes)
    preview.write_segment([folder / "hd.exr"], folder / "hd.mp4", folder / "hd.png")
    return folder / "hd.mp4"


def first_frame(path: Path) -> av.VideoFrame:
    """The first picture of a video."""
    with av.open(str(path)) as container:
        return next(container.decode(video=0))


def test_the_video_is_tagged_bt709(video: Path) -> None:
    frame = first_frame(video)
    assert (int(frame.colorspace), int(frame.color_primaries), int(frame.color_range)) == (1, 1, 1)
    assert frame.color_trc == ColorTrc.IEC61966_2_1, "the code values are sRGB's"


@pytest.mark.parametrize("bar", BARS)
def test_a_player_shows_the_colours(video: Path, bar: str) -> None:
    shown = first_frame(video).reformat(format="rgb24", src_colorspace="ITU709", dst_colorspace="ITU709").to_ndarray()
    found = shown[HEIGHT // 2, 200 + 427 * list(BARS).index(bar)].astype(int)
    assert np.abs(found - 255 * np.array(BARS[bar])).max() <= 3


def test_a_shot_of_one_pixel_delivers_its_picture_and_says_why_there_is_no_video(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", size=(1, 1))
    assert check(folder).refusal == ""
    run_here(folder, "composite")
    assert Session(folder).output.exr_path("t", FRAME).exists()
    try:
        run_here(folder, "preview")
    except Exception as error:
        told = str(error)
    else:
        told = " ".join(check(folder).warnings)
    assert "1x1" in told
    assert "video" in told
