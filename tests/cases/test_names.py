"""File names and frame lists that users have."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from fileseq.exceptions import FileSeqException

from tests.cases.shots import FRAME, check, write_shot
from yesnt.core.errors import UsageError
from yesnt.io.jobfile import parse_frames


@pytest.mark.parametrize("folder", ["50%d", "a#b"])
def test_a_folder_may_hold_the_signs_of_a_frame_number(tmp_path: Path, folder: str) -> None:
    shot = write_shot(tmp_path / "s", plate={"path": f"{folder}/plate.####.exr"})
    (shot / folder).mkdir()
    (shot / f"plate.{FRAME}.exr").rename(shot / folder / f"plate.{FRAME}.exr")
    try:
        refusal = check(shot).refusal
    except FileSeqException as error:
        refusal = f"traceback: {error}"
    assert refusal == ""


def test_a_single_file_may_hold_a_number_between_dots(tmp_path: Path) -> None:
    shot = write_shot(tmp_path / "s", camera="cam.01.json")
    (shot / "camera.json").rename(shot / "cam.01.json")
    assert check(shot).refusal == ""


def test_a_windows_path_is_named_as_that(tmp_path: Path) -> None:
    shot = write_shot(tmp_path / "s", plate={"path": r"C:\shots\plate.####.exr"})
    refusal = check(shot).refusal
    assert "Windows" in refusal or "backslash" in refusal


def sparse(count: int) -> str:
    """Every fifth frame as a list."""
    return ",".join(str(FRAME + 5 * i) for i in range(count))


def processor_seconds(count: int) -> float:
    """What it takes to read a sparse list."""
    start = time.process_time()
    assert len(parse_frames(sparse(count), "frames")) == count
    return time.process_time() - start


def test_sparse_frame_lists_take_linear_time() -> None:
    parse_frames("1", "frames")  # imports
    short, long = (min(processor_seconds(count) for _ in range(3)) for count in (100, 400))
    assert long < 8 * short, f"four times the frames took {long / short:.1f} times as long"


def test_too_many_frames_are_refused_with_how_many_are_allowed() -> None:
    with pytest.raises(UsageError) as caught:
        parse_frames("1-1000001", "frames")
    assert re.search(r"\b1[,_ ]?000[,_ ]?000\b", str(caught.value))
