"""Elapsed time and time left, from events at given times."""

from __future__ import annotations

import re
from typing import Any

import pytest

from yesnt.cli.progress import BarProgress, LineProgress
from yesnt.cli.text import time_text
from yesnt.planning.stages import STAGES
from yesnt.planning.time_left import TimeLeft

PLAN = {"event": "plan", "stages": {"flow": 10, "solve": 1}, "reused": {"flow": 2}}


def done(stage: str, seconds: float) -> dict[str, Any]:
    return {"event": "done", "stage": stage, "frames": [1001], "seconds": seconds, "peak_bytes": 1e9}


def test_work_left_is_shared_by_the_workers_that_were_busy() -> None:
    now = [100.0]
    clock = TimeLeft(2.0, lambda: now[0])
    for event in (PLAN, {"event": "start", "stage": "flow", "frames": [1]}):
        clock.apply(event)
    assert clock.left is None
    now[0] = 110.0
    for _ in range(4):
        clock.apply(done("flow", 5.0))  # 20 s of work in 10 s: two workers
    solve = STAGES["solve"].cost.seconds + 2 * STAGES["solve"].cost.seconds_per_megapixel
    assert clock.left == pytest.approx((4 * 5 + solve) / 2)
    assert clock.elapsed == 10
    for event in (*[done("flow", 5.0)] * 4, done("solve.sweep1", 9.0)):
        clock.apply(event)
    assert clock.left == 0
    assert time_text(clock) == "10.0 s elapsed, about 0.0 s left"


def test_lines_and_bars_show_them(capsys: pytest.CaptureFixture[str]) -> None:
    lines = LineProgress(0.1)
    bars = BarProgress(0.1)
    for event in (PLAN, {"event": "start", "stage": "flow", "frames": [1001]}, done("flow", 1.0)):
        lines(event)
        bars(event)
    assert re.search(r"progress 27%, 0\.\d s elapsed, about \d", capsys.readouterr().out)
    whole = bars._progress.tasks[-1]
    assert (whole.description, whole.completed, whole.total) == ("all", 3, 11)
    assert " elapsed, about " in whole.fields["left"]
