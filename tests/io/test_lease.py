"""Leases: one owner among many claimants, on hosts whose clocks disagree, whatever happens to the owner."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from yesnt.core.errors import LeaseLostError
from yesnt.io import lease as module
from yesnt.io.lease import Lease, Observer, read_lease, take_lease
from yesnt.io.process_identity import ProcessIdentity

NAME = "driver"
SHORT = 0.4
CLAIM = "import sys; from pathlib import Path; from yesnt.io.lease import Lease; l = Lease(Path(sys.argv[1]), 'driver')"


def from_another_host(folder: Path, monkeypatch: pytest.MonkeyPatch, beat_seconds: float = 60) -> Lease:
    """A lease that a process of another host holds."""
    own = ProcessIdentity.own()
    with monkeypatch.context() as patch:
        patch.setattr(ProcessIdentity, "own", classmethod(lambda cls: replace(own, host="far", boot="another")))
        held = Lease(folder, NAME, beat_seconds)
        assert held.claim(None)
    return held


def test_a_held_lease_is_refused_at_once_and_free_after_its_release(tmp_path: Path) -> None:
    held = take_lease(tmp_path, NAME, patient=False)
    assert held is not None
    held.confirm()
    assert take_lease(tmp_path, NAME, patient=False) is None
    assert take_lease(tmp_path, "another", patient=False) is not None
    held.release()
    assert read_lease(tmp_path, NAME) is None
    again = take_lease(tmp_path, NAME, patient=False)
    assert again is not None
    again.release()


def test_of_many_claims_at_once_one_wins(tmp_path: Path) -> None:
    for _ in range(20):
        claims, start = [Lease(tmp_path, NAME) for _ in range(32)], threading.Barrier(32)
        won: list[Lease] = []

        def claim(lease: Lease, start: threading.Barrier = start, won: list[Lease] = won) -> None:
            start.wait()
            if lease.claim(None):
                won.append(lease)

        threads = [threading.Thread(target=claim, args=(lease,)) for lease in claims]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(won) == 1
        won[0].confirm()
        won[0].release()
    assert not list(tmp_path.iterdir()), "no litter"


def test_a_process_that_died_on_this_host_is_replaced_at_once(tmp_path: Path) -> None:
    command = [sys.executable, "-c", f"{CLAIM}; import os; assert l.claim(None); os._exit(1)", str(tmp_path)]
    subprocess.run(command, check=False)
    taken = []
    began = time.monotonic()
    held = take_lease(tmp_path, NAME, patient=False, taken_over=taken.append)
    assert held is not None
    assert time.monotonic() - began < 1
    assert taken[0].owner.host == ProcessIdentity.own().host
    assert [path.name for path in tmp_path.iterdir()] == ["driver.2"]
    held.release()


def test_a_driver_on_another_host_is_alive_while_its_counter_advances(tmp_path: Path, monkeypatch) -> None:
    held = from_another_host(tmp_path, monkeypatch, 0.1)
    assert take_lease(tmp_path, NAME, patient=False, expiry_seconds=SHORT) is None
    held.confirm()
    held.release()


@pytest.mark.parametrize("skew", [-86400.0, 0.0, 86400.0])
def test_a_silent_driver_on_another_host_is_replaced_after_the_observers_own_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, skew: float
) -> None:
    """A skewed clock shows in the times of files and in `time.time`; neither is read."""
    held, waited = from_another_host(tmp_path, monkeypatch), []
    (path,) = tmp_path.iterdir()
    os.utime(path, (time.time() + skew, time.time() + skew))
    monkeypatch.setattr(time, "time", lambda: 0.0)
    began = time.monotonic()
    other = take_lease(tmp_path, NAME, patient=True, waiting=waited.append, expiry_seconds=SHORT)
    assert other is not None
    assert SHORT <= time.monotonic() - began < 3
    assert [str(state.owner) for state in waited] == [f"host far, pid {os.getpid()}"]
    with pytest.raises(LeaseLostError, match=r"no longer holds the lease \(it is now held by host .*, pid \d+\)"):
        held.confirm()
    other.confirm()
    held.release()
    other.confirm()
    other.release()


def test_an_observer_that_looked_before_a_takeover_does_not_take_over_again(tmp_path: Path, monkeypatch) -> None:
    from_another_host(tmp_path, monkeypatch)
    seen = read_lease(tmp_path, NAME)
    second = Lease(tmp_path, NAME)
    assert second.claim(seen)
    second.release()
    assert not Lease(tmp_path, NAME).claim(seen), "the owner that it saw is long gone, and so is its successor"
    assert not list(tmp_path.iterdir())


def test_an_owner_that_lives_on_keeps_its_lease_from_a_claim_made_too_early(tmp_path: Path, monkeypatch) -> None:
    held = from_another_host(tmp_path, monkeypatch, 0.05)
    seen = read_lease(tmp_path, NAME)
    while read_lease(tmp_path, NAME) == seen:
        time.sleep(0.01)
    assert not Lease(tmp_path, NAME).claim(seen)
    held.confirm()
    held.release()


def test_a_removed_lease_is_lost_and_does_not_come_back(tmp_path: Path) -> None:
    held = Lease(tmp_path, NAME, 0.02)
    assert held.claim(None)
    (path,) = tmp_path.iterdir()
    path.unlink()
    time.sleep(0.1)
    assert not path.exists()
    with pytest.raises(LeaseLostError, match="held by nobody"):
        held.confirm()


def test_a_disk_without_hard_links_has_leases_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(source: object, target: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(module.os, "link", refused)
    held = Lease(tmp_path, NAME)
    assert held.claim(None)
    assert not Lease(tmp_path, NAME).claim(None)
    held.confirm()
    held.release()


def test_a_lease_that_is_not_whole_yet_counts_as_held_by_an_unknown_owner(tmp_path: Path) -> None:
    (tmp_path / "driver.1").write_bytes(b"")
    observer = Observer(tmp_path, NAME, SHORT)
    assert not observer.vacant()
    assert not observer.certain
    time.sleep(SHORT)
    assert observer.vacant()


def test_numbers_of_processes_that_are_used_again_are_told_apart() -> None:
    own = ProcessIdentity.own()
    assert own.is_running()
    assert not own.has_ended()
    assert replace(own, start="1").has_ended()
    far = replace(own, boot="another", start="1")
    assert not far.has_ended()
    assert not far.is_running()


def test_a_process_that_nobody_waited_for_has_ended() -> None:
    code = "from yesnt.io.process_identity import ProcessIdentity as P; print(P.own().start)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    start = process.stdout.read().strip()
    own = ProcessIdentity.own()
    deadline = time.monotonic() + 5
    while not replace(own, pid=process.pid, start=start).has_ended() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert replace(own, pid=process.pid, start=start).has_ended()
    process.communicate()
