"""Files are whole or absent, and a full disk is told as one."""

from __future__ import annotations

import errno
import os
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from yesnt.io import durable
from yesnt.io.durable import PAUSES, disk_full, durable_path, is_full, write_bytes
from yesnt.io.exr import write_exr


@pytest.mark.parametrize(
    ("error", "full"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), True),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), True),
        (RuntimeError("Failed to write pixel data. No space left on device."), True),  # as OpenEXR says it
        (OSError(errno.EIO, "Input/output error"), False),
        (ValueError("no space"), False),
    ],
)
def test_a_full_disk_is_known_whoever_says_it(tmp_path: Path, error: Exception, full: bool) -> None:
    assert is_full(error) is full
    path = tmp_path / "a.bin"
    with pytest.raises(OSError if full else type(error)) as caught, durable_path(path):
        raise error
    if full:
        assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(path))
        assert str(disk_full(caught.value, "frame 3")).startswith(f"The disk is full. Where: {path}, frame 3.")
    assert os.listdir(tmp_path) == []


@contextmanager
def small_files() -> Iterator[None]:
    """No file may grow beyond 4 kB: only around the writes, for the log of the test run may be a file too."""
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_write_that_is_cut_short_leaves_what_was_there(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a", b"old")
    noise = np.random.default_rng(0).random((64, 64)).astype(np.float32)
    with small_files():
        with pytest.raises(OSError, match="large"):
            write_bytes(tmp_path / "a", bytes(10000))
        with pytest.raises((OSError, RuntimeError)):
            write_exr(tmp_path / "a.exr", {"Y": noise})
    assert (tmp_path / "a").read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses that were made; no time passes."""
    made: list[float] = []
    monkeypatch.setattr(durable.time, "sleep", made.append)
    return made


def failing(monkeypatch: pytest.MonkeyPatch, name: str, times: int, code: int) -> None:
    """Makes a function of `os` fail that often."""
    whole, left = getattr(os, name), [times]

    def call(*arguments: object, **options: object) -> object:
        if left[0] > 0:
            left[0] -= 1
            raise OSError(code, os.strerror(code))
        return whole(*arguments, **options)

    monkeypatch.setattr(os, name, call)


@pytest.mark.parametrize("code", [errno.EACCES, errno.EBUSY, errno.ESTALE])
@pytest.mark.parametrize("name", ["replace", "fsync", "open"])
def test_a_disk_that_refuses_for_a_moment_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pauses: list[float], name: str, code: int
) -> None:
    failing(monkeypatch, name, 2, code)
    write_bytes(tmp_path / "a", b"whole")
    assert (tmp_path / "a").read_bytes() == b"whole"
    assert pauses == list(PAUSES[:2])


def test_a_lasting_refusal_is_reported_after_a_bounded_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pauses: list[float]
) -> None:
    failing(monkeypatch, "replace", 1000, errno.EACCES)
    with pytest.raises(PermissionError):
        write_bytes(tmp_path / "a", b"whole")
    assert sum(pauses) < 5
    assert os.listdir(tmp_path) == []


def test_other_errors_are_reported_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pauses: list[float]
) -> None:
    failing(monkeypatch, "replace", 1, errno.EIO)
    with pytest.raises(OSError, match="Input/output"):
        write_bytes(tmp_path / "a", b"whole")
    assert pauses == []
