"""Processes that share a shot without a driver, and the template with which a farm starts them."""

from __future__ import annotations

import hashlib
import re
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.tiny_shot import write_tiny_shot
from yesnt.cli.app import app
from yesnt.cli.progress import line_progress
from yesnt.cli.text import print_error
from yesnt.core.errors import UsageError
from yesnt.core.frame_ranges import frame_ranges
from yesnt.io.jobfile import parse_frames
from yesnt.planning.stages import COMPOSITE, RELIGHT
from yesnt.runtime.control import share as module
from yesnt.runtime.control.open_job import FORMAT_VARIABLE, MOST_TASKS, OPEN_JOB, open_job_template
from yesnt.runtime.control.share import run_shared
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node


def digests(path: Path) -> dict[str, str]:
    files = (path.parent / "out" / "exr").glob("*.exr")
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_processes_share_the_work_and_give_what_one_gives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = write_tiny_shot(tmp_path / "alone", 4)
    run_shared(Session(alone), RunOptions())
    assert (alone.parent / "out" / "run" / "preview.mp4").exists()
    path, made, lock = write_tiny_shot(tmp_path / "shared", 4), list[str](), threading.Lock()

    def counted(job, node):
        receipt = run_node(job, node)
        with lock:
            made.append(f"{node.stage} {node.frames[0]}")
        return receipt

    monkeypatch.setattr(module, "run_node", counted)
    results: list = []

    def share(frames: str) -> None:
        results.append(run_shared(Session(path), RunOptions(frames)))

    threads = [threading.Thread(target=share, args=(frames,)) for frames in ("1001-1002", "1003-1004")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(100)
    assert len(results) == 2
    assert digests(path) == digests(alone)
    assert not any(result.missing for result in results)
    assert not list((path.parent / "out" / "run" / "leases" / "tasks").iterdir())


def test_a_task_that_fails_costs_its_own_frames_alone(tiny_shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[int] = []

    def failing(job, node):
        if node.stage == RELIGHT and node.frames == (1002,):
            tries.append(1)
            raise RuntimeError("broken")
        return run_node(job, node)

    monkeypatch.setattr(module, "run_node", failing)
    events: list = []
    result = run_shared(Session(tiny_shot), RunOptions("1001-1004"), events.append)
    assert result.missing == {(RELIGHT, 1002): "RuntimeError: broken"}
    assert len(tries) == 2
    assert len([one for one in result.outcome.done if one[0] == COMPOSITE]) == 3
    assert sorted(digests(tiny_shot)) == ["tiny.1001.exr", "tiny.1003.exr", "tiny.1004.exr"]
    assert [event["event"] for event in events if event["event"] not in ("start", "done")] == [
        "plan",
        "retry",
        "failed",
    ]


def test_share_goes_with_no_option_of_a_driver(tiny_shot: Path) -> None:
    for option in (("--cluster", "slurm"), ("--workers", "2"), ("--force", "flow")):
        result = CliRunner().invoke(app, ["run", str(tiny_shot), "--share", *option], standalone_mode=False)
        assert isinstance(result.exception, UsageError)
        assert f"no driver that {option[0]} could mean" in str(result.exception)


def test_the_template_is_valid_and_holds_every_frame_once(tmp_path: Path) -> None:
    from openjd import model

    frames = tuple(range(1001, 1101, 2))
    template = open_job_template("walk ü", tmp_path / "a b" / "shot.yaml", frames, 8)
    job = model.decode_job_template(template=template)
    assert [step.name for step in job.steps] == ["Check", "Frames", "Preview"]
    (parameter,) = template["steps"][1]["parameterSpace"]["taskParameterDefinitions"]
    assert parameter["range"][0] == "1001-1015x2"
    assert [f for text in parameter["range"] for f in parse_frames(text, "")] == list(frames)


@pytest.mark.parametrize("count", [1, MOST_TASKS, 10_000])
def test_long_shots_have_no_more_tasks_than_allowed(tmp_path: Path, count: int) -> None:
    from openjd import model

    template = open_job_template("x" * 300, tmp_path, tuple(range(count)), 1)
    model.decode_job_template(template=template)
    (parameter,) = template["steps"][1]["parameterSpace"]["taskParameterDefinitions"]
    assert len(parameter["range"]) == min(count, 1000 if count == 10_000 else count)
    assert frame_ranges(f for text in parameter["range"] for f in parse_frames(text, "")) == frame_ranges(range(count))


def test_the_exported_commands_do_the_shot_and_tell_the_farm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs the template's commands as a farm would, its one step after the other."""
    import yaml

    path, file = write_tiny_shot(tmp_path / "a shot", 2), tmp_path / "job.yaml"
    result = CliRunner().invoke(app, ["export-openjd", str(path), "--output", str(file), "--chunk", "1"])
    assert result.exit_code == 0, result.output
    template = yaml.safe_load(file.read_text())
    for name, value in template["jobEnvironments"][0]["variables"].items():
        monkeypatch.setenv(name, value)
    told: dict[str, list[float]] = {}
    for step in template["steps"]:
        space = step.get("parameterSpace", {"taskParameterDefinitions": [{"range": [""]}]})
        for value in space["taskParameterDefinitions"][0]["range"]:
            words = [w.replace("{{Task.Param.Frames}}", value) for w in step["script"]["actions"]["onRun"]["args"]]
            command = [w.replace("{{Param.Shot}}", template["parameterDefinitions"][0]["default"]) for w in words]
            done = CliRunner().invoke(app, command, standalone_mode=False)
            assert not done.exception, done.output
            assert done.return_value in (None, 0), done.output
            told[f"{step['name']} {value}"] = [
                float(p) for p in re.findall(r"(?m)^openjd_progress: (.+)$", done.output)
            ]
    assert sorted(digests(path)) == ["tiny.1001.exr", "tiny.1002.exr"]
    assert sorted(told) == ["Check ", "Frames 1001", "Frames 1002", "Preview "]
    for shares in (told["Frames 1001"], told["Frames 1002"], told["Preview "]):
        assert shares == sorted(shares)
        assert shares[0] > 0
        assert shares[-1] == 100
    assert (path.parent / "out" / "run" / "preview.mp4").exists()
    assert re.search(r"(?m)^openjd_status: \d+ of \d+ tasks done, .+ elapsed", done.output)


def test_a_farm_is_told_of_what_others_do_and_why_a_command_failed(monkeypatch, capsys) -> None:
    plan = {"event": "plan", "stages": {"flow": 4}, "reused": {"flow": 1}}
    elsewhere = {"event": "done_elsewhere", "stage": "flow", "frames": [1002]}
    for event in (plan, elsewhere):
        line_progress()(event)
    assert "openjd" not in capsys.readouterr().out, "other farms get none of these lines"
    monkeypatch.setenv(FORMAT_VARIABLE, OPEN_JOB)
    progress = line_progress()
    for event in (plan, elsewhere):
        progress(event)
    assert "progress 50%, 0.0 s elapsed\nopenjd_progress: 50.0\nopenjd_status: 2 of 4 tasks" in capsys.readouterr().out
    print_error(UsageError("Two\nlines", "--share", "one", "leave one out"), as_json=False)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("openjd_fail: Two lines")
