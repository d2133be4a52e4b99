"""The frame grid on a scheduler's dashboard, read by a program and, where one is installed, by a real browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from yesnt.planning.frame_grid import DONE, FrameGrid
from yesnt.planning.graph import Graph, Node
from yesnt.planning.stages import COMPOSITE, RELIGHT
from yesnt.runtime.live_grid import LiveGrid, frame_grid_of

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
GREEN = np.array([0x6B, 0x9D, 0x3F])  # of a finished frame, blue first


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            protocol="tcp",
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
        ) as cluster,
        Client(cluster, set_as_default=False) as made,
    ):
        yield made


def publish(client: Any, frames: int, name: str) -> LiveGrid:
    """A job whose first half is relit and whose third frame could not be."""
    numbers = tuple(range(1001, 1001 + frames))
    grid = FrameGrid(numbers, 1.0)
    live = LiveGrid(name, grid, lambda frame: jpeg())
    nodes = [Node(stage, i, (n,), {"n": n}) for stage in (RELIGHT, COMPOSITE) for i, n in enumerate(numbers)]
    live.lay_out(Graph(nodes), [(RELIGHT, i) for i in range(frames // 2) if i != 2])
    live.apply({"event": "start", "stage": "composite", "frames": [1001]})
    live.apply({"event": "done", "stage": "composite", "frames": [1001], "seconds": 0.5})
    reason = "<b>its worker died 2 times</b>"
    live.apply({"event": "dead", "stage": "relight", "frames": [1003], "reason": reason})
    live.published(client)
    live.close()
    return live


def jpeg() -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((40, 64, 3), 128, np.uint8))[1])


def fetch(client: Any, path: str) -> bytes:
    with urllib.request.urlopen(frame_grid_of(client.dashboard_link) + path, timeout=10) as answer:
        return bytes(answer.read())


def test_state_and_picture_of_each_job(client: Any) -> None:
    publish(client, 16, "first")
    publish(client, 4, "second one")
    jobs = {job["name"]: job for job in json.loads(fetch(client, "/state.json"))["jobs"]}
    assert jobs["first"]["frames"] == "1001-1016"
    assert jobs["first"]["stages"][0]["runs"][0] == [DONE, 2]
    assert jobs["first"]["lost"] == [{"stage": "relight", "frame": 1003, "reason": "<b>its worker died 2 times</b>"}]
    assert fetch(client, "/preview.jpg?job=second%20one") == jpeg()
    with pytest.raises(urllib.error.HTTPError, match="404"):
        fetch(client, "/preview.jpg?job=unknown")


def test_the_page_takes_no_commands(client: Any) -> None:
    publish(client, 4, "read only")
    for path in ("", "/state.json", "/preview.jpg"):
        request = urllib.request.Request(frame_grid_of(client.dashboard_link) + path, data=b"{}", method="POST")
        with pytest.raises(urllib.error.HTTPError, match="405"):
            urllib.request.urlopen(request, timeout=10)


def test_a_scheduler_without_the_page_does_not_end_a_run() -> None:
    live = LiveGrid("job", FrameGrid((1,), 1.0), lambda frame: b"")
    assert live.published("no client at all") == "no client at all"
    live.close()


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("frames", [16, 10_000])
def test_a_browser_shows_the_frames(client: Any, tmp_path: Path, frames: int) -> None:
    publish(client, frames, "shot")
    dom = browse(client, tmp_path / "page.png")
    relight = re.search(r'data-stage="relight".*?aria-label="([^"]*)"', dom, re.DOTALL)
    assert relight is not None
    assert relight[1] == f"{frames // 2} waiting, {frames // 2 - 1} done, 1 dead"
    assert f"{frames} frames, about" in dom
    assert "relight 1003: &lt;b&gt;its worker died 2 times&lt;/b&gt;" in dom, "as text, not as markup"
    assert "preview.jpg?job=shot" in dom
    picture = np.asarray(cv2.imread(str(tmp_path / "page.png")), np.int64)
    green = (np.abs(picture - GREEN) < 8).all(-1).sum()
    assert green > 2 * (frames // 2 - 1), "cells of finished frames are drawn"


def browse(client: Any, picture: Path) -> str:
    """The page's document after its scripts have run; its picture goes to a file."""
    assert BROWSER is not None
    address = frame_grid_of(client.dashboard_link)
    common = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000"]
    profile = f"--user-data-dir={picture.parent / 'profile'}"
    subprocess.run(
        [*common, profile, "--window-size=1400,900", f"--screenshot={picture}", address],
        check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    dumped = subprocess.run([*common, profile, "--dump-dom", address], check=True, capture_output=True, timeout=60)
    return dumped.stdout.decode()
