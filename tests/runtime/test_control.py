"""A run that was handed over is looked after from elsewhere: what its files say, and what commands do without it."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import JobError, RunCancelledError, UsageError
from yesnt.inspect.logs import RunLines, frame_logs
from yesnt.inspect.run_view import look
from yesnt.io.commands import take_commands
from yesnt.io.lease import Lease
from yesnt.io.output import DRIVER, OutputFolder
from yesnt.io.process_identity import ProcessIdentity
from yesnt.planning.stages import COMPOSITE, DECOMPOSE, RELIGHT
from yesnt.runtime.control import submission as submission_module
from yesnt.runtime.control.commands import ask, open_output, skip
from yesnt.runtime.control.submission import VARIABLE, Submission, keep, note_end
from yesnt.runtime.control.submit import SubmitOptions, submit_run
from yesnt.runtime.run_log import EventStream, RunLog, open_run_log
from yesnt.runtime.run_options import forget_with_users, parse_force, wanted_frames, wanted_order
from yesnt.runtime.session import Session


@pytest.fixture
def output(tiny_shot: Path) -> OutputFolder:
    return open_output(tiny_shot)[1]


@pytest.fixture
def held(output: OutputFolder):
    """The driver's lease, held by this process."""
    with output.lock() as lease:
        yield lease


def events_of(output: OutputFolder) -> list[dict]:
    return [json.loads(line) for line in output.events.read_text().splitlines()]


def test_the_state_of_a_run_follows_its_events(output: OutputFolder, held: Lease) -> None:
    log = RunLog(output.run_state, held, "tiny-1")
    with open_run_log(log, output.events, ()) as tell:
        assert (look(output).state, look(output).run) == ("running", held.nonce)
        tell({"event": "paused", "by": "ann@far"})
        assert (look(output).state, look(output).by) == ("paused", "ann@far")
        tell({"event": "resumed", "by": "ann@far"})
        tell({"event": "shortage", "stage": "relight", "reason": "no licence"})
        tell({"event": "shortage", "stage": "", "reason": "no room"})
        tell({"event": "shortage_over", "stage": ""})
        tell({"event": "host_blocked", "host": "h", "reason": "why"})
        tell({"event": "cluster", "dashboard": "http://x"})
        seen = look(output)
        assert (seen.state, seen.shortages, seen.blocked_hosts) == ("running", {"relight": "no licence"}, {"h": "why"})
        assert (seen.dashboard, seen.pid, seen.active) == ("http://x", os.getpid(), True)
    log.end(RunCancelledError("The run was cancelled by ann@far"), 0)
    held.release()
    over = look(output)
    assert (over.state, over.exit_status, over.error) == ("cancelled", 130, "The run was cancelled by ann@far.")
    assert over.over
    assert [event["event"] for event in events_of(output)][:2] == ["run", "paused"]


@pytest.mark.parametrize(
    ("error", "missing", "expected"),
    [
        (None, 0, ("ended", 0)),
        (None, 2, ("ended", 3)),
        (KeyboardInterrupt(), 0, ("cancelled", 130)),
        (RuntimeError("x"), 0, ("failed", 1)),
    ],
)
def test_the_end_of_a_run_has_its_exit_status(
    output: OutputFolder, held: Lease, error: BaseException | None, missing: int, expected: tuple[str, int]
) -> None:
    RunLog(output.run_state, held, "").end(error, missing)
    held.release()
    assert (look(output).state, look(output).exit_status) == expected


def test_a_driver_that_died_is_seen_to_have_died(output: OutputFolder) -> None:
    code = f"""
import os
from pathlib import Path
from yesnt.io.output import OutputFolder
from yesnt.runtime.run_log import RunLog
output = OutputFolder(Path({str(output.root)!r}))
context = output.lock()
RunLog(output.run_state, context.__enter__(), "").save()
os._exit(9)
"""
    subprocess.run([sys.executable, "-c", code], check=False)
    assert look(output).state == "died"


def test_a_driver_of_another_host_that_gives_no_sign_is_silent(output: OutputFolder, monkeypatch) -> None:
    own = ProcessIdentity.own()
    far = replace(own, host="far", boot="another")
    monkeypatch.setattr(ProcessIdentity, "own", classmethod(lambda cls: far))
    output.leases.mkdir(parents=True)
    quiet = Lease(output.leases, DRIVER, 60)
    assert quiet.claim(None)
    seen = look(output, 0.3)
    assert (seen.state, seen.host, seen.active) == ("silent", "far", True)
    assert (output.leases / "driver.1").exists(), "looking changes nothing"


def test_without_a_run_commands_are_refused(tiny_shot: Path, output: OutputFolder) -> None:
    assert look(output).state == "none"
    for verb in ("pause", "resume", "cancel"):
        with pytest.raises(JobError, match=rf"No run of this job is under way \(the last one: none\).*a run to {verb}"):
            ask(tiny_shot, verb)
    assert not output.root.exists()


def test_a_command_names_the_run_that_it_is_for(tiny_shot: Path, output: OutputFolder, held: Lease) -> None:
    assert ask(tiny_shot, "pause").run == held.nonce
    (command,) = take_commands(output.commands)
    assert (command.verb, command.run) == ("pause", held.nonce)


def queued(output: OutputFolder) -> Submission:
    made = Submission("tiny-1", "slurm", "slurm 7", "ann@far", 1.0, ("x",))
    keep(output, made)
    return made


def test_a_submission_that_has_not_begun_can_be_cancelled(tiny_shot: Path, output: OutputFolder) -> None:
    queued(output)
    seen = ask(tiny_shot, "cancel")
    assert (seen.state, seen.run, seen.job) == ("queued", "tiny-1", "slurm 7")
    assert [command.run for command in take_commands(output.commands)] == ["tiny-1"]


def test_a_submission_whose_driver_ended_before_its_run_failed(
    tiny_shot: Path, output: OutputFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    queued(output)
    monkeypatch.setenv(VARIABLE, "tiny-0")
    note_end(output, 1)
    assert look(output).state == "queued", "another submission's driver ended"
    monkeypatch.setenv(VARIABLE, "tiny-1")
    note_end(output, 1)
    seen = look(output)
    assert (seen.state, seen.exit_status, seen.error) == ("failed", 1, "see `yesnt logs SHOT`")


def test_frames_are_skipped_without_a_driver_too(tiny_shot: Path) -> None:
    run, chosen = skip(tiny_shot, "1002-1003", "relight")
    assert (run.state, chosen) == ("none", (1002, 1003))
    session = Session(tiny_shot)
    assert set(session.marked_dead()) == {(RELIGHT, 1002), (RELIGHT, 1003)}
    assert next(iter(session.marked_dead().values())).startswith("skipped by ")
    assert [n.frames for n in session.graph() if n.stage == COMPOSITE] == [(1001,), (1004,)]
    with pytest.raises(UsageError, match=r"Stage 'solve' cannot be skipped.*decompose, flow, relight, composite"):
        skip(tiny_shot, "1002", "solve")
    with pytest.raises(UsageError, match="no frame 7"):
        skip(tiny_shot, "7", "relight")


def test_a_driver_is_asked_to_skip(tiny_shot: Path, output: OutputFolder, held: Lease) -> None:
    skip(tiny_shot, "1002", "decompose")
    (command,) = take_commands(output.commands)
    assert (command.verb, command.stage, command.frames) == ("skip", "decompose", (1002,))
    assert not Session(tiny_shot).marked_dead()


def test_a_damaged_mark_leaves_its_frame_out(tiny_shot: Path) -> None:
    session = Session(tiny_shot)
    session.dead_marks.set(DECOMPOSE, [1002], "why")
    (session.output.dead / "decompose" / "1002.json").write_text("{")
    assert session.marked_dead() == {(DECOMPOSE, 1002): "its mark is damaged"}


def test_submit_passes_options_on_and_leaves_at_once(
    tiny_shot: Path, output: OutputFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[list[str]] = []

    def spawn(path: str, command: list[str], environment: object, **options: object) -> int:
        started.append(command)
        assert options["setsid"]
        return 7

    monkeypatch.setattr(submission_module.os, "posix_spawn", spawn)
    made = submit_run(tiny_shot, SubmitOptions("local", 3, frames="1001-1002", until="solve", force=("flow",)))
    (command,) = started
    assert command[:2] == ["/usr/bin/env", f"{VARIABLE}={made.id}"]
    expected = f"-m yesnt run {tiny_shot} --cluster local --workers 3 --frames 1001-1002 --until solve --force flow"
    assert " ".join(command[3:]) == expected
    assert look(output).submission == made.id
    assert made.job.endswith("pid 7")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"until": "polish"}, "No stage 'polish'"),
        ({"force": ("polish:1001",)}, "No stage 'polish'"),
        ({"frames": "7"}, "no frame 7"),
    ],
)
def test_submit_refuses_what_a_quick_look_can_refuse(
    tiny_shot: Path, output: OutputFolder, options: dict, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        submit_run(tiny_shot, SubmitOptions("local", **options))
    assert not output.root.exists()


def test_submit_refuses_a_job_that_is_being_run(tiny_shot: Path, held: Lease) -> None:
    with pytest.raises(JobError, match=r"run already by host .*pid \d+"):
        submit_run(tiny_shot, SubmitOptions("local"))


def test_events_wait_for_room_and_no_line_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, write, full = EventStream(tmp_path / "events"), os.write, [False]

    def limited(descriptor: int, data: bytes) -> int:
        if full[0] and len(data) > 10:
            write(descriptor, data[:5])  # what fits
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", limited)
    stream.write({"event": "one"})
    full[0] = True
    stream.write({"event": "two"})
    assert (tmp_path / "events").read_text() == '{"event": "one"}\n'
    full[0] = False
    stream.write({"event": "three"})
    stream.close()
    assert [json.loads(line)["event"] for line in (tmp_path / "events").read_text().splitlines()] == [
        "one", "two", "three",
    ]  # fmt: skip


def test_logs_are_of_the_last_run_and_of_one_frame(output: OutputFolder) -> None:
    output.run.mkdir(parents=True)
    lines = [
        {"event": "run"},
        {"event": "old"},
        {"event": "run"},
        {"event": "done", "stage": "relight", "seconds": 1.0},
    ]
    output.events.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert list(RunLines(output).fresh()) == ["run", 'done stage="relight" seconds=1.000']
    assert list(RunLines(output, "flow").fresh()) == []
    log = output.log_path("relight", 1002)
    log.parent.mkdir(parents=True)
    log.write_text("start\ndone\n")
    assert frame_logs(output, 1002, None) == ["relight: start", "relight: done"]
    with pytest.raises(JobError, match="Frame 1003 has no log"):
        frame_logs(output, 1003, None)


def test_forced_frames_are_forgotten_with_all_that_uses_them(tiny_shot: Path) -> None:
    session = Session(tiny_shot)
    graph, job = session.graph(), session.job
    forgotten: list[tuple[str, int]] = []
    book = type("Book", (), {"forget": lambda self, stage, frame: forgotten.append((stage.name, frame))})()
    forget_with_users(graph, book, parse_force(job, "relight:1002"))
    assert {one for one in forgotten if one[0] != "preview"} == {("relight", 1002), ("composite", 1002)}
    assert ("preview", 1001) in forgotten
    with pytest.raises(UsageError, match=r"no frame 9. Where: --force relight:9"):
        parse_force(job, "relight:9")


def test_frames_come_in_the_order_in_which_they_are_named(tiny_shot: Path) -> None:
    job = Session(tiny_shot).job
    assert wanted_frames(job, "1003,1001-1004") == (1003, 1001, 1002, 1004)
    assert wanted_frames(job, "1001-1004:2") == (1001, 1003, 1002, 1004)
    assert wanted_order(job, "1001-1004x2") == ()
    assert wanted_order(job, None) == ()
    assert wanted_order(job, "1004,1001") == (1004, 1001)


@pytest.mark.timeout(200)
def test_a_submitted_run_is_paused_skipped_resumed_and_ends(tmp_path: Path) -> None:
    """In a folder with spaces and letters of all kinds."""
    path = write_tiny_shot(tmp_path / "a shot é日", 2)
    output = open_output(path)[1]
    submit_run(path, SubmitOptions("local", 1))
    skip_late = time.monotonic() + 100
    while look(output, 0).state == "queued" and time.monotonic() < skip_late:
        time.sleep(0.1)
    ask(path, "pause")
    while look(output, 0).state != "paused" and time.monotonic() < skip_late:
        time.sleep(0.1)
    skip(path, "1002", "relight")
    ask(path, "resume")
    while not look(output, 0).over and time.monotonic() < skip_late + 60:
        time.sleep(0.2)
    seen = look(output)
    assert (seen.state, seen.exit_status) == ("ended", 3), output.driver_log.read_text()
    assert [file.name for file in output.exr.iterdir()] == ["tiny.1001.exr"]
    assert "Paused by " in output.driver_log.read_text()
    assert {event["event"] for event in events_of(output)} >= {"run", "paused", "resumed", "skipped"}
