"""The command line as a user meets it: verbs, exit statuses, JSON, one paragraph per error."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.tiny_shot import write_tiny_shot
from yesnt.cli.app import app
from yesnt.core.errors import JobError, UsageError

READERS_OF_A_SHOT = (
    ("plan",), ("run",), ("status",), ("retry",), ("verify",), ("report",), ("explain", "1001"), ("trade",),
    ("submit", "--cluster", "local"), ("export-openjd",), ("logs",),
    ("pause",), ("resume",), ("cancel",), ("skip", "--frames", "1001"),
)  # fmt: skip
"""Verbs of the contract that begin by reading a job file, with their further arguments."""

TESTED_ELSEWHERE = {"demo", "init", "doctor", "eval", "stage", "camera", "capture", "gof"}
"""Verbs whose work a test below, or a test of their own folder, covers."""


def yesnt(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "yesnt", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=200)


def called(*arguments: str | Path) -> BaseException | None:
    """What a command raises, in this process."""
    return CliRunner().invoke(app, list(map(str, arguments)), standalone_mode=False).exception


@pytest.mark.parametrize("verb", READERS_OF_A_SHOT, ids=lambda verb: verb[0])
def test_verbs_of_a_shot_read_its_job_file_first(verb: tuple[str, ...], tmp_path: Path) -> None:
    name, *more = verb
    error = called(name, tmp_path / "absent", *more)
    assert isinstance(error, JobError)
    assert str(error).startswith("The job file is missing. Where: ")


def test_verbs_that_need_other_folders_refuse_what_is_not_there(tmp_path: Path) -> None:
    error = called("eval", tmp_path, "--output", tmp_path / "out")
    assert isinstance(error, UsageError)
    assert "no shot with truth" in str(error)
    error = called("stage", "nothing", "--out", tmp_path, "--cache", tmp_path)
    assert isinstance(error, UsageError)
    assert "No set 'nothing'" in str(error)


def test_every_verb_is_tested() -> None:
    """A verb that is added is added here too, with what it does."""
    assert set(typer.main.get_command(app).commands) == {name for name, *_ in READERS_OF_A_SHOT} | TESTED_ELSEWHERE


@pytest.mark.parametrize(
    "arguments", [(), ("bake",), ("run",), ("run", "x", "--workers", "0"), ("explain", "x", "one")]
)
def test_wrong_usage_is_exit_2(arguments: tuple[str, ...]) -> None:
    done = yesnt(*arguments)
    assert done.returncode == 2
    assert done.stderr or done.stdout


def test_errors_are_one_paragraph_or_one_document(tmp_path: Path) -> None:
    done = yesnt("run", tmp_path / "absent")
    assert done.returncode == 1
    assert done.stderr.startswith("yesnt: The job file is missing. Where: ")
    assert done.stderr.count("\n") == 1
    document = json.loads(yesnt("run", tmp_path / "absent", "--json").stdout)
    assert set(document["error"]) == {"what", "where", "expected", "do"}


def test_init_writes_a_job_that_is_valid_and_never_overwrites(tmp_path: Path) -> None:
    from yesnt.io.jobfile import load_shot

    assert yesnt("init", tmp_path / "walk").returncode == 0
    assert load_shot(tmp_path / "walk" / "shot.yaml").name == "walk"
    again = yesnt("init", tmp_path / "walk")
    assert again.returncode == 1
    assert "There is a job file already" in again.stderr


def test_a_shot_from_plan_to_verify(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 2)
    plan = json.loads(yesnt("plan", path, "--json").stdout)
    assert {row["stage"]: row["todo"] for row in plan["stages"]} == {
        "decompose": 2, "flow": 1, "confidence": 1, "solve": 1, "relight": 2, "composite": 2, "preview": 1,
    }  # fmt: skip
    written = {file.name for file in (path.parent / "out").rglob("*") if file.is_file()}
    assert written <= {"file_digests.json", "facts.json", "plate_headers.json", "record_index.json"}, (
        "plan writes what it learned of the inputs"
    )
    done = yesnt("run", path, "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert "Frame 1002 composite done" in done.stdout
    assert "progress 100%" in done.stdout
    assert "Dask dashboard: http://127.0.0.1:" in done.stdout
    assert (path.parent / "out" / "run" / "report.html").read_text().count("data:image/png") == 3
    states = json.loads(yesnt("status", path, "--json").stdout)["states"]
    assert {(state["stage"], state["state"], state["frames"]) for state in states} >= {
        ("composite", "done", "1001-1002")
    }
    assert {state["state"] for state in states} == {"done"}
    assert yesnt("verify", path).returncode == 0
    (path.parent / "out" / "exr" / "tiny.1001.exr").unlink()
    broken = yesnt("verify", path)
    assert broken.returncode == 1
    assert "composite 1001: exr/tiny.1001.exr is missing" in broken.stdout
    assert yesnt("verify", path, "--repair", "--workers", "1").returncode == 0
    assert yesnt("verify", path).returncode == 0
    assert "everything is as it was" in yesnt("explain", path, "1001").stdout
    assert "1 of 2" not in yesnt("plan", path).stdout


def test_logs_before_the_first_run_say_so(tmp_path: Path) -> None:
    assert "No run of this job has begun" in str(called("logs", write_tiny_shot(tmp_path / "shot", 1)))


def test_missing_frames_are_exit_3_and_named(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 3)
    marks = path.parent / "out" / "run" / "dead" / "relight"
    marks.mkdir(parents=True)
    for frame, reason in ((1002, "it killed two workers"), (1003, "skipped by ann@here")):
        (marks / f"{frame}.json").write_text(json.dumps({"stage": "relight", "frame": frame, "reason": reason}))
    done = yesnt("run", path, "--workers", "1")
    assert done.returncode == 3, done.stderr
    assert "Missing: frame 1002 of relight: it killed two workers" in done.stdout
    assert "Some frames are missing; `yesnt retry SHOT` tries them again." in done.stdout
    assert "Frames that you skipped are left out; `yesnt retry SHOT --frames 1003` takes them" in done.stdout
    assert (path.parent / "out" / "exr" / "tiny.1001.exr").exists()
    again = yesnt("retry", path, "--frames", "1002", "--workers", "1")
    assert again.returncode == 3
    assert "tries them again" not in again.stdout, "no frame was lost, one was skipped"
    assert (path.parent / "out" / "exr" / "tiny.1002.exr").exists()


def test_interrupt_that_falls_into_a_finaliser_is_not_lost() -> None:
    program = """
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell inherits an ignored one
from yesnt import cli

class Finalised:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def command():
    Finalised()
    time.sleep(20)

cli._run = command
cli.main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == "Interrupted: what is committed stays, the same command goes on from there.\n"


@pytest.mark.parametrize("moment", ["while the cluster starts", "while tasks run"])
def test_interrupt_is_one_line_within_seconds_and_loses_nothing(tmp_path: Path, moment: str) -> None:
    path = write_tiny_shot(tmp_path / "shot", 4)
    process = subprocess.Popen(
        [sys.executable, "-m", "yesnt", "run", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
        # A shell gives its background jobs an ignored SIGINT, which children would inherit.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stdout is not None
    for line in process.stdout:
        if ("tasks" if moment == "while the cluster starts" else " decompose done ") in line:
            break
    os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it: to the driver, its workers and their server
    sent = time.monotonic()
    _, errors = process.communicate(timeout=60)
    took = time.monotonic() - sent
    assert process.returncode == 130, errors
    lines = [line for line in errors.splitlines() if line and not line.startswith(("Hashing files", "Checking frames"))]
    assert lines == ["Interrupted: what is committed stays, the same command goes on from there."]
    assert took < 3, f"took {took:.1f} s"
    if moment == "while tasks run":
        assert list((path.parent / "out" / "run" / "records").glob("*/*.json"))


def test_doctor_finds_this_machine_fit() -> None:
    done = yesnt("doctor", "--json")
    assert done.returncode == 0
    assert {"openexr", "OpenImageIO", "scratch", "cores"} <= {finding["part"] for finding in json.loads(done.stdout)}


def test_without_blender_the_stage_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("YESNT_BLENDER", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    monkeypatch.chdir(tmp_path)
    done = yesnt("stage", "objects", "--small")
    assert done.returncode == 1
    assert "Blender is not here" in done.stderr
    assert "make blender" in done.stderr
    assert yesnt("stage", "movies").returncode == 2
