"""Workers that live on, workers that leave, files that are held by others, long shots, and Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from distributed import LocalCluster
from distributed.comm import CommClosedError

from tests.cases.shots import (
    FRAME,
    HEIGHT,
    POSE_OPENGL,
    WIDTH,
    camera,
    deliver,
    write_json,
    write_shot,
)
from tests.in_process import run_here
from yesnt.core.errors import ClusterLostError
from yesnt.planning.chunks import Extent
from yesnt.runtime import session as session_module
from yesnt.runtime.cluster.open_cluster import open_cluster
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.session import Session

INTERRUPT_SECONDS = 3.0
GRAPH_SECONDS, GRAPH_FRAMES = 5.0, 10_000


def test_a_worker_that_lives_on_takes_the_changed_camera(tmp_path: Path) -> None:
    turned = camera(pose=POSE_OPENGL)
    kept, fresh = write_shot(tmp_path / "kept"), write_shot(tmp_path / "fresh")
    deliver(kept)
    for folder in (kept, fresh):
        write_json(folder / "camera.json", turned)
    again, right = deliver(kept), deliver(fresh)
    np.testing.assert_array_equal(again.planes["relit.R"], right.planes["relit.R"])


def test_attaching_waits_while_the_only_worker_leaves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    token = tmp_path / "token"
    token.touch()
    monkeypatch.setenv("YESNT_TEST_LEAVE", str(token))
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        try:
            with open_cluster(ClusterSpec(cluster.scheduler_address), ("tests.cases.leaving_worker",)) as client:
                assert client.submit(len, "abc", pure=False).result(timeout=60) == 3
        except ClusterLostError:
            pass  # exit status 75 and one sentence
        except (CommClosedError, OSError) as error:
            raise AssertionError(f"not a sentence for the user: {error!r}") from error
    assert not token.exists(), "the first worker has left"


def test_a_rename_that_fails_twice_loses_no_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace, refusals = os.replace, [1, 2]

    def held_by_another(source: object, target: object, **options: object) -> None:
        if str(target).endswith(f"t.{FRAME}.exr") and refusals:
            refusals.pop()
            raise PermissionError(13, "Access is denied", str(target))
        replace(source, target, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "replace", held_by_another)
    folder = write_shot(tmp_path / "s")
    try:
        session = run_here(folder, "composite")
    except PermissionError as error:
        raise AssertionError(f"given up with {len(refusals)} refusals to go: {error}") from error
    assert not refusals
    assert session.output.exr_path("t", FRAME).exists()


@contextmanager
def processor_time_limit(seconds: float) -> Iterator[None]:
    """Ends what takes more processor time than that, by an assertion."""

    def over(number: int, frame: FrameType | None) -> None:
        raise AssertionError(f"more than {seconds} s of processor time")

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def test_the_graph_of_a_long_shot_takes_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each sequence is one file, so that only the graph is long."""
    names = {"plate": "plate", "gbuffer": "gbuffer", "decompose": "material"}
    job = {key: {"path": f"{name}.exr"} for key, name in names.items()}
    folder = write_shot(tmp_path / "s", numbers=f"{FRAME}-{FRAME + GRAPH_FRAMES - 1}", **job)
    for name in names.values():
        (folder / f"{name}.{FRAME}.exr").rename(folder / f"{name}.exr")
    write_json(folder / "camera.json", camera(tuple(range(FRAME, FRAME + GRAPH_FRAMES))))
    monkeypatch.setattr(session_module, "matte_extent", lambda job: Extent(HEIGHT, WIDTH, 0.5, 0.3))
    session = Session(folder)
    assert session.chunks.chunk < GRAPH_FRAMES
    with processor_time_limit(GRAPH_SECONDS):
        graph = session.graph()
    assert len(graph) > 4 * GRAPH_FRAMES


def test_ctrl_c_ends_a_run_with_one_line(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", tuple(range(FRAME, FRAME + 6)))
    with subprocess.Popen(
        [sys.executable, "-m", "yesnt", "run", str(folder), "--workers", "1"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:  # fmt: skip
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if "dashboard" in line.lower():
                    break
            start = time.monotonic()
            os.killpg(process.pid, signal.SIGINT)
            told = [line for line in process.stdout.read().splitlines() if line.strip()]
            status = process.wait(timeout=60)
            seconds = time.monotonic() - start
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    assert status == 130
    assert [line for line in told if line.startswith("Interrupted")] == told[-1:]
    assert not [line for line in told if "Traceback" in line or line.startswith(" ")], told
    assert seconds <= INTERRUPT_SECONDS
