"""One seeded disturbance each; a scenario returns what it did, or raises AssertionError."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.chaos.jobs import FRAMES, ROOT, digests, finish, new_job, start
from tests.chaos.poisoned import HOW
from tests.in_process import run_here
from yesnt.inspect.verify import verify
from yesnt.io.pictures.image import read_image
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session

WORKER_POINTS = ("record.before_commit", "record.after_commit", "exr.before_rename", "shard.before_rename")
DRIVER_POINTS = ("driver.after_submit", "driver.after_receipt")
KINDS = ("worker kill", "worker segfault", "worker exit", "driver kill", "power cut")
POISON_SECONDS = 15.0
PAGE = 4096


def kill(seed: int, folder: Path, reference: dict[str, str]) -> dict[str, object]:
    """Ends a worker, the driver, or all at once, somewhere; the run after it delivers what an undisturbed one does."""
    choice, kind = random.Random(seed), KINDS[seed % len(KINDS)]
    path, token = new_job(folder), folder / "token"
    if kind == "power cut":
        process = start(path)
        time.sleep(choice.uniform(1.0, 9.0))
        struck = process.poll() is None
        if struck:
            os.killpg(process.pid, signal.SIGKILL)
        finish(process)
    else:
        token.touch()
        point = choice.choice(DRIVER_POINTS if kind == "driver kill" else WORKER_POINTS)
        how = kind.split()[1]
        code, out = finish(start(path, fault=f"{point}:{choice.randint(1, 4)}:{token}:{how}"))
        struck = not token.exists()
        assert code in (0, -signal.SIGKILL), out
    code, out = finish(start(path))
    assert code == 0, out
    assert digests(path) == reference
    assert not list(path.parent.rglob("*.partial")), "litter is swept"
    assert not list((path.parent / "out" / "run" / "leases").rglob("*.*")), "no lease is left"
    return {"kind": kind, "struck": struck}


def poison(seed: int, folder: Path, reference: dict[str, str]) -> dict[str, object]:
    """A frame that always ends its worker is the only one that is lost, and costs little time."""
    choice, how = random.Random(seed), HOW[seed % len(HOW)]
    frame, stage = 1001 + choice.randrange(FRAMES), choice.choice(("relight", "composite"))
    began = time.monotonic()
    code, out = finish(start(new_job(folder / "clean")))
    usual = time.monotonic() - began
    assert code == 0, out
    os.environ["CHAOS_POISON"] = f"{stage}:{frame}:{how}"
    began = time.monotonic()
    path = new_job(folder / "poisoned")
    code, out = finish(start(path, module="tests.chaos.poisoned"))
    extra = time.monotonic() - began - usual
    assert code == 3, out
    expected = {name: digest for name, digest in reference.items() if f".{frame}." not in name}
    assert digests(path) == expected
    assert {(lost.name, number) for lost, number in Session(path).marked_dead()} == {(stage, frame)}, out
    assert extra <= POISON_SECONDS, f"{extra:.1f} s"
    return {"kind": f"{stage} {how}", "seconds": round(extra, 1)}


def damage(seed: int, path: Path, reference: dict[str, str]) -> dict[str, object]:
    """One random damage of the finished job's store, records or EXRs is found and repaired exactly, in this process.

    Of ten, seven are flips of one bit; the others cut a file, empty it, swap two, or remove one.
    """
    choice = random.Random(seed)
    how = ("flip",) * 7 + ("cut", "empty", "swap")
    kind = how[seed % len(how)]
    file = choice.choice(committed_files(path))
    spoil(choice, kind, file, path)
    session = Session(path)
    found = verify(session)
    assert found, f"{kind} of {file.relative_to(path.parent)} is not found"
    for one in found:
        session.book.forget(one.stage, one.frame)
    run_here(path, "composite")
    assert not verify(Session(path))
    assert digests(path) == reference
    return {"kind": kind, "file": str(file.relative_to(path.parent / "out"))}


def committed_files(path: Path) -> list[Path]:
    """Shards, records and EXRs of a job."""
    out = path.parent / "out"
    shards = [file for file in (out / "store.zarr").rglob("*") if file.is_file() and "c" in file.parts]
    found = [*shards, *(out / "run" / "records").glob("*/*.json"), *(out / "exr").glob("*.exr")]
    return sorted(file for file in found if file.stat().st_size)


def spoil(choice: random.Random, kind: str, file: Path, path: Path) -> None:
    """Damages a file as told; its times are those from before, as after a fault of the disk."""
    data, times = bytearray(file.read_bytes()), (file.stat().st_atime_ns, file.stat().st_mtime_ns)
    if kind == "flip":
        data[choice.randrange(len(data))] ^= 1 << choice.randrange(8)
    elif kind == "cut":
        del data[choice.randrange(len(data)) :]
    elif kind == "empty":
        data.clear()
    else:
        others = [o for o in committed_files(path) if o.suffix == file.suffix and o.read_bytes() != bytes(data)]
        data = bytearray(choice.choice(others).read_bytes())
    file.write_bytes(bytes(data))
    os.utime(file, ns=times)


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """A disk of its own of a few megabytes; needs the right to mount."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def can_mount(folder: Path) -> bool:
    """Whether this process may mount a disk."""
    try:
        with small_disk(folder / "probe", PAGE * 4):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


def full_disk(pages: int, path: Path, reference: dict[str, str]) -> dict[str, object]:
    """A disk with room for so many pages: whatever write meets its end, no invalid file has a final name.

    The job's output lies on a disk of its own; when there is room, the job goes on and delivers the same bytes.
    """
    output = path.parent / "out"
    shutil.rmtree(output, ignore_errors=True)
    with small_disk(output, 64 << 20):
        free = shutil.disk_usage(output).free
        filler = output / "filler"
        filler.write_bytes(b"\0" * (free - pages * PAGE))
        met = ""
        try:
            run_here(path, "composite")
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            met = str(error.filename or error)[-60:]
        assert_all_whole(path)
        filler.unlink()
        run_here(path, "composite")
        assert not verify(Session(path))
        assert digests(path) == reference
    return {"pages": pages, "met": met}


def disk_fills(seed: int, folder: Path, reference: dict[str, str]) -> dict[str, object]:
    """The disk fills up while workers run: the run pauses, says so, and goes on by itself when there is room."""
    path = new_job(folder)
    output, events = path.parent / "out", []
    wanted = 1 + random.Random(seed).randrange(12)

    def listen(event: Mapping[str, Any]) -> None:
        events.append(event["event"])
        if events.count("done") == wanted and not filler.exists():
            with suppress(OSError), filler.open("wb") as stream:
                while True:
                    stream.write(b"\0" * PAGE)
                    stream.flush()
        if event["event"] == "shortage":
            filler.unlink(missing_ok=True)

    with small_disk(output, 64 << 20):
        filler = output / "filler"
        result = Session(path).run(RunOptions(), listen)
        assert not result.missing, result.missing
        assert digests(path) == reference
        logged = [json.loads(line)["event"] for line in (output / "run" / "events.jsonl").read_text().splitlines()]
        assert {"shortage", "shortage_over"} <= set(logged)
        assert logged.count("done") == events.count("done")
    return {"full after": wanted, "deferred": events.count("deferred")}


def assert_all_whole(path: Path) -> None:
    """Every file under a final name is whole, whether a record names it or not."""
    out = path.parent / "out"
    for file in (out / "run").rglob("*.json"):
        json.loads(file.read_text())
    for file in (out / "exr").glob("*.exr"):
        read_image(file)
    if (out / "store.zarr" / "zarr.json").exists():
        assert not verify(Session(path))


CLAIM = """
import sys, time
from pathlib import Path
from yesnt.io.lease import Lease
folder, rounds, begin = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
for number in range(rounds):
    while time.monotonic() < begin + number * 0.25:
        pass
    lease = Lease(folder, f"frame{number}")
    print(int(lease.claim(None)))
time.sleep(max(0, begin + rounds * 0.25 - time.monotonic()))
"""


def claims(seed: int, folder: Path, processes: int = 32, rounds: int = 10) -> dict[str, object]:
    """Many processes claim the same frame at the same moment: one wins, each time."""
    target = folder / f"claims{seed}"
    target.mkdir(parents=True)
    begin = str(time.monotonic() + 2 + processes / 8)
    command = [sys.executable, "-c", CLAIM, str(target), str(rounds), begin]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) for _ in range(processes)]
    won = [[int(word) for word in process.communicate()[0].split()] for process in running]
    assert [sum(column) for column in zip(*won, strict=True)] == [1] * rounds
    return {"rounds": rounds, "processes": processes}


def two_drivers(seed: int, folder: Path, reference: dict[str, str]) -> dict[str, object]:
    """Two runs of one job at nearly the same time: one does it, the other is refused or finds everything done."""
    path = new_job(folder)
    first = start(path)
    time.sleep(random.Random(seed).uniform(0.0, 6.0))
    second = start(path)
    ends = [finish(first), finish(second)]
    codes = sorted(code for code, _ in ends)
    assert codes in ([0, 0], [0, 1]), ends
    assert codes == [0, 0] or any("run already by host" in out for _, out in ends), ends
    assert digests(path) == reference
    return {"codes": codes}


SKEW = 86_400


def odd_surroundings(seed: int, folder: Path, reference: dict[str, str]) -> dict[str, object]:
    """Paths of all kinds, inputs that cannot be written, and file times a day off change no byte."""
    name = ("with a space", "ünïcödé 日本", "semi;colon'quote", "a.b..c")[seed % 4]
    path = new_job(folder / name)
    skew = (SKEW, -SKEW)[seed % 2]
    inputs = [file for file in path.parent.iterdir() if file.is_file()]
    for file in inputs:
        os.utime(file, (time.time() + skew, time.time() + skew))
        file.chmod(0o444)
    before = {file: file.read_bytes() for file in inputs}
    output = folder / "results" / name
    path.chmod(0o644)
    path.write_text(path.read_text() + f"output: {json.dumps(str(output))}\n")
    path.parent.chmod(0o555)
    try:
        run_here(path, "composite")
    finally:
        path.parent.chmod(0o755)
    assert all(file.read_bytes() == data for file, data in before.items() if file != path)
    assert sorted(file.name for file in path.parent.iterdir()) == sorted(file.name for file in inputs)
    delivered = {file.name: file.read_bytes() for file in (output / "exr").glob("*.exr")}
    assert len(delivered) == FRAMES
    return {"name": name, "skew": skew}


SCENARIOS: dict[str, Callable[..., dict[str, object]]] = {
    "kill": kill, "poison": poison, "damage": damage, "full_disk": full_disk, "disk_fills": disk_fills,
    "claims": claims, "two_drivers": two_drivers, "odd_surroundings": odd_surroundings,
}  # fmt: skip
