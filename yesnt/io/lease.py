"""Leases on a shared disk: one owner at a time, without locks of one host and without comparing clocks.

A lease is a file `NAME.GENERATION` with its owner and a counter that the owner raises every few seconds. The highest
generation owns. Claiming creates the next generation under a name that must not exist, which one of any number of
claimants achieves. A claimant may do so where no generation exists, where the owner's process has ended (seen on the
owner's own host only), or where the counter has not changed for `EXPIRY_SECONDS` of the claimant's own monotonic
clock. Wall clocks and file times are never read, so hosts may disagree about the time by any amount.
"""

from __future__ import annotations

import errno
import json
import os
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from yesnt.core.errors import LeaseLostError
from yesnt.io.process_identity import ProcessIdentity

BEAT_SECONDS = 2.0
"""How often an owner raises its counter."""

EXPIRY_SECONDS = 30.0
"""How long an observer must see the counter unchanged before the owner counts as gone: NFS may serve an old copy of a
file for some seconds, and a busy disk may delay a write."""

_POLL_SECONDS = 0.2
_COUNTER_DIGITS = 16


@dataclass(frozen=True)
class LeaseState:
    """A lease as an observer sees it.

    Attributes:
        generation: number of the claim.
        owner: host and process that hold it; None if the file is not whole yet.
        nonce: random name of the claim.
        beat: the owner's counter.
    """

    generation: int
    owner: ProcessIdentity | None
    nonce: str
    beat: str


class Lease:
    """One claim of a name. It is held from `claim` to `release`, or until another process takes it over.

    Args:
        folder: on a disk that all claimants share.
        name: what is claimed, usable as a file name.
        beat_seconds: how often the counter is raised.
    """

    def __init__(self, folder: Path, name: str, beat_seconds: float = BEAT_SECONDS) -> None:
        self._folder, self._name, self._beat_seconds = folder, name, beat_seconds
        self._generation = 0
        self.nonce = uuid.uuid4().hex
        """Random name of this claim."""
        self._lost = ""
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def claim(self, over: LeaseState | None) -> bool:
        """Tries to become the owner; whether that worked.

        Args:
            over: the state that allows it: None where nobody holds the name, else that of the owner that is gone.
        """
        generation = 1 if over is None else over.generation + 1
        path = self._path(generation)
        if not _create(path, self.nonce):
            return False
        self._generation = generation
        now = read_lease(self._folder, self._name)
        # The generation that was taken over is removed last: if it is gone, another claimant came and went meanwhile.
        replaced = over is None or read_generation(self._path(over.generation)) == over
        if now is None or now.nonce != self.nonce or not replaced:
            path.unlink(missing_ok=True)
            return False
        for older in _generations(self._folder, self._name):
            if older < generation:
                self._path(older).unlink(missing_ok=True)
        self._start()
        return True

    def confirm(self) -> None:
        """Makes sure that this process still is the owner; called before every write that only an owner may do.

        Raises:
            LeaseLostError: another process has taken over, or the lease's file was removed.
        """
        if not self._lost and (
            _is_there(self._path(self._generation + 1)) or not _is_there(self._path(self._generation))
        ):
            self._lose()
        if self._lost:
            raise LeaseLostError(
                f"This process no longer holds the lease ({self._lost})", str(self._path(self._generation)),
                "one process at a time", "nothing is lost: the other process goes on from what is committed",
            )  # fmt: skip

    def release(self) -> None:
        """Lets go, so that the next claimant does not wait."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        with suppress(OSError):
            self._path(self._generation).unlink(missing_ok=True)

    def _path(self, generation: int) -> Path:
        return self._folder / f"{self._name}.{generation}"

    def _start(self) -> None:
        self._thread = threading.Thread(target=self._beat, name=f"lease {self._name}", daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        count = 0
        while not self._ended.wait(self._beat_seconds):
            count += 1
            try:
                _raise_counter(self._path(self._generation), count)
            except FileNotFoundError:
                self._lose()
                return
            except OSError:  # the disk is away for a moment; if it stays away, others take over and `confirm` says so
                continue

    def _lose(self) -> None:
        now = read_lease(self._folder, self._name)
        owner = "nobody" if now is None or now.nonce == self.nonce else str(now.owner or "another process")
        self._lost = f"it is now held by {owner}"


def read_lease(folder: Path, name: str) -> LeaseState | None:
    """The state of a name; None if nobody claims it."""
    for generation in sorted(_generations(folder, name), reverse=True):
        state = read_generation(folder / f"{name}.{generation}")
        if state is not None:
            return state
    return None


def read_generation(path: Path) -> LeaseState | None:
    """The state of one file of a lease; None if it is gone."""
    try:
        # Opening a file makes a network disk ask for its present content.
        text = path.read_text()
    except FileNotFoundError:
        return None
    counter, _, rest = text.partition("\n")
    try:
        document = json.loads(rest)
        owner, nonce = ProcessIdentity(**document["owner"]), str(document["nonce"])
    except (ValueError, TypeError, KeyError):
        owner, nonce = None, ""
    return LeaseState(int(path.name.rpartition(".")[2]), owner, nonce, counter)


class Observer:
    """Watches a name until it may be claimed.

    Args:
        folder: of the leases.
        name: of the lease.
        expiry_seconds: how long the counter must stand still.
    """

    def __init__(self, folder: Path, name: str, expiry_seconds: float = EXPIRY_SECONDS) -> None:
        self._folder, self._name, self._expiry = folder, name, expiry_seconds
        self._seen: LeaseState | None = None
        self._since = time.monotonic()
        self.state: LeaseState | None = None
        self.advanced = False

    def vacant(self) -> bool:
        """Whether the name may be claimed now; `state` is then what `Lease.claim` takes, `advanced` whether it beat."""
        now = self.state = read_lease(self._folder, self._name)
        if now is None:
            return True
        if now.owner is not None and now.owner.has_ended():
            return True
        if now != self._seen:
            self.advanced = self._seen is not None
            self._seen, self._since = now, time.monotonic()
        return time.monotonic() - self._since >= self._expiry

    @property
    def certain(self) -> bool:
        """Whether the owner is known to be alive: its counter moved, or its process is seen on this host."""
        owner = None if self.state is None else self.state.owner
        return self.advanced or (owner is not None and owner.is_running())


def take_lease(
    folder: Path,
    name: str,
    patient: bool,
    taken_over: Callable[[LeaseState], None] = lambda state: None,
    waiting: Callable[[LeaseState], None] = lambda state: None,
    expiry_seconds: float = EXPIRY_SECONDS,
) -> Lease | None:
    """Claims a name; of an owner that is gone it is taken over.

    Args:
        folder: of the leases.
        name: what is claimed.
        patient: whether to wait while a living process holds it; if not, None is returned.
        taken_over: called with the state of an owner that was gone.
        waiting: called once with the state of the present owner.
        expiry_seconds: how long an owner's counter must stand still until the owner counts as gone.
    """
    folder.mkdir(parents=True, exist_ok=True)
    observer, told = Observer(folder, name, expiry_seconds), False
    while True:
        if observer.vacant():
            lease = Lease(folder, name)
            if lease.claim(observer.state):
                if observer.state is not None:
                    taken_over(observer.state)
                return lease
            continue
        if observer.certain and not patient:
            return None
        if not told and observer.state is not None:
            waiting(observer.state)
            told = True
        time.sleep(_POLL_SECONDS)


def _generations(folder: Path, name: str) -> list[int]:
    """Generations of a name that exist as files."""
    try:
        with os.scandir(folder) as entries:
            found = [entry.name.rpartition(".") for entry in entries]
    except FileNotFoundError:
        return []
    return [int(number) for stem, _, number in found if stem == name and number.isdigit()]


def _create(path: Path, nonce: str) -> bool:
    """Creates a whole lease file under a name that must not exist; whether it is ours.

    A hard link is atomic on every network disk. Where the disk has no hard links, an exclusive creation is; its content
    follows, and until then the file counts as held by an unknown owner.
    """
    document = json.dumps({"owner": asdict(ProcessIdentity.own()), "nonce": nonce})
    data = f"{0:0{_COUNTER_DIGITS}d}\n{document}\n".encode()
    temporary = path.with_name(f".{path.name}.{nonce}.partial")
    try:
        temporary.write_bytes(data)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    try:
        os.link(temporary, path)
    except FileExistsError:
        pass  # NFS says so too when an answer was lost and the request was sent twice: the content decides
    except OSError:
        return _create_exclusively(path, data)
    finally:
        temporary.unlink(missing_ok=True)
    state = read_generation(path)
    return state is not None and state.nonce == nonce


def _create_exclusively(path: Path, data: bytes) -> bool:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    except FileExistsError:
        return False
    try:
        os.write(descriptor, data)
        os.fsync(descriptor)
    except OSError:
        path.unlink(missing_ok=True)  # a full disk: nobody could read who holds it
        raise
    finally:
        os.close(descriptor)
    return True


def _raise_counter(path: Path, count: int) -> None:
    """Overwrites the counter in place: it needs no room on a full disk, and never brings a removed file back."""
    descriptor = os.open(path, os.O_WRONLY)
    try:
        os.pwrite(descriptor, f"{count:0{_COUNTER_DIGITS}d}".encode(), 0)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _is_there(path: Path) -> bool:
    """Whether a file exists now; a network disk answers `stat` from memory for up to a minute, but not `open`."""
    try:
        os.close(os.open(path, os.O_RDONLY))
    except FileNotFoundError:
        return False
    except OSError as error:
        if error.errno == errno.ESTALE:
            return False
        raise
    return True
