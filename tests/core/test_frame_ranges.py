"""Frames as text: the form that `frames:` takes, short, and without loss."""

from __future__ import annotations

import random

import pytest

from yesnt.core.frame_ranges import frame_ranges
from yesnt.io.jobfile import parse_frames


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ([], ""),
        ([7], "7"),
        ([1, 2], "1-2"),
        ([3, 1, 2], "1-3"),
        ([1, 3], "1,3"),
        ([1, 3, 5, 7], "1-7x2"),
        ([1, 2, 3, 10, 20, 30, 31], "1-3,10-30x10,31"),
        ([-3, -2, -1, 0], "-3-0"),
        (range(1001, 11001), "1001-11000"),
    ],
)
def test_runs_with_one_step_are_ranges(frames: list[int], text: str) -> None:
    assert frame_ranges(frames) == text


def test_the_text_names_exactly_these_frames() -> None:
    chance = random.Random(1)
    for _ in range(200):
        frames = chance.sample(range(-20, 40), chance.randint(1, 30))
        assert parse_frames(frame_ranges(frames), "here") == tuple(sorted(frames))
