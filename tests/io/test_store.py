import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st

from yesnt.core.errors import CorruptError
from yesnt.io.store import FrameStore, array_digest

SHAPE = (2, 20, 24)


def frame(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(SHAPE, dtype=np.float32)


@pytest.fixture
def store(tmp_path: Path) -> FrameStore:
    return FrameStore.create(tmp_path / "s.zarr", {"observed": "observed"}, range(3), 20, 24)


def test_a_frame_comes_back_exactly(store: FrameStore) -> None:
    digest = store.write("observed", 1, frame(1))
    np.testing.assert_array_equal(store.read("observed", 1, digest), frame(1))
    assert digest == array_digest(frame(1))


@pytest.mark.parametrize("size", [(1, 1), (255, 3), (256, 257), (300, 520)])
def test_every_size_is_one_shard_a_frame(tmp_path: Path, size: tuple[int, int]) -> None:
    store = FrameStore.create(tmp_path / "s.zarr", {"z": "z"}, range(2), *size)
    values = np.random.default_rng(0).random((1, *size), dtype=np.float32)
    digest = store.write("z", 0, values)
    np.testing.assert_array_equal(store.read("z", 0, digest), values)
    assert [p for p in (tmp_path / "s.zarr" / "z" / "c").rglob("*") if p.is_file()] == [store.shard_path("z", 0)]


def test_partial_frames_are_refused(store: FrameStore) -> None:
    with pytest.raises(ValueError, match="is not a whole frame"):
        store.write("observed", 0, frame(0)[:, :4])


def test_creating_again_keeps_what_is_there(store: FrameStore) -> None:
    digest = store.write("observed", 0, frame(0))
    again = FrameStore.create(store.path, {"observed": "observed", "solve.0": "material"}, range(3), 20, 24)
    np.testing.assert_array_equal(again.read("observed", 0, digest), frame(0))


@pytest.mark.parametrize("linkable", [True, False])
def test_a_frame_is_carried_over_without_its_pixels(
    store: FrameStore, linkable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(source: Path, path: Path) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    FrameStore.create(store.path, {"solve.0": "material", "solve.1": "material"}, range(3), 20, 24)
    if not linkable:
        monkeypatch.setattr(os, "link", refuse)
    digest = store.write("solve.0", 1, frame(1))
    for _ in range(2):  # a task that is killed after it does it again
        store.link("solve.0", "solve.1", 1)
    store.write("solve.0", 1, frame(2))
    np.testing.assert_array_equal(store.read("solve.1", 1, digest), frame(1))
    assert [p for p in store.path.rglob("*") if ".partial" in p.name] == []


def test_only_frames_of_one_form_that_are_there_are_carried_over(store: FrameStore) -> None:
    FrameStore.create(store.path, {"solve.0": "material", "z": "z"}, range(3), 20, 24)
    with pytest.raises(ValueError, match="not of one form"):
        store.link("z", "solve.0", 0)
    with pytest.raises(CorruptError, match="its file is missing"):
        store.link("observed", "solve.0", 0)


def _delete(path: Path, other: Path) -> None:
    path.unlink()


def _empty(path: Path, other: Path) -> None:
    path.write_bytes(b"")


def _halve(path: Path, other: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _swap(path: Path, other: Path) -> None:
    shutil.copy(other, path)


@pytest.mark.parametrize("fault", [_delete, _empty, _halve, _swap])
def test_every_fault_is_found(store: FrameStore, fault) -> None:
    digest = store.write("observed", 0, frame(0))
    store.write("observed", 1, frame(1))
    fault(store.shard_path("observed", 0), store.shard_path("observed", 1))
    with pytest.raises(CorruptError, match=r"A stored frame is damaged.*position 0.*--repair"):
        store.read("observed", 0, digest)


@settings(max_examples=60, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_every_flipped_bit_is_found(tmp_path_factory: pytest.TempPathFactory, where: float, bit: int) -> None:
    store = FrameStore.create(tmp_path_factory.mktemp("s") / "s.zarr", {"observed": "observed"}, range(1), 20, 24)
    digest = store.write("observed", 0, frame(0))
    path = store.shard_path("observed", 0)
    data = bytearray(path.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    path.write_bytes(data)
    with pytest.raises(CorruptError):
        store.read("observed", 0, digest)


OBSERVED = {"observed": "observed"}


def held(store: FrameStore, positions: range) -> dict[int, float]:
    """First value of every stored frame, by position."""
    return {p: float(store.read("observed", p)[0, 0, 0]) for p in positions if store.shard_path("observed", p).exists()}


@pytest.mark.parametrize(
    ("frames", "after"),
    [
        (range(1001, 1005), {0: 1.0, 1: 2.0, 2: 3.0, 3: 4.0}),
        (range(999, 1005), {2: 1.0, 3: 2.0, 4: 3.0, 5: 4.0}),
        (range(1002, 1004), {0: 2.0, 1: 3.0}),
        ([-3, -2, 7, 1001, 1004, 1010], {3: 1.0, 4: 4.0}),
    ],
)
def test_frames_follow_their_numbers_when_the_range_changes(tmp_path: Path, frames, after) -> None:
    store = FrameStore.create(tmp_path / "s.zarr", OBSERVED, range(1001, 1005), 20, 24)
    for position in range(4):
        store.write("observed", position, np.full((2, 20, 24), 1 + position, np.float32))
    changed = FrameStore.create(store.path, OBSERVED, frames, 20, 24)
    assert held(changed, range(len(frames))) == after
    back = FrameStore.create(store.path, OBSERVED, range(1001, 1005), 20, 24)
    assert held(back, range(4)) == {value - 1: value for value in sorted(after.values())}
    assert sorted(path.name for path in store.path.iterdir() if path.is_dir()) == ["observed"]


@pytest.mark.parametrize("renamed", [0, 1], ids=["before the first rename", "between the renames"])
def test_a_move_that_is_killed_leaves_the_old_array_or_the_new(tmp_path: Path, renamed, monkeypatch) -> None:
    store = FrameStore.create(tmp_path / "s.zarr", OBSERVED, range(1, 5), 20, 24)
    for position in range(4):
        store.write("observed", position, np.full((2, 20, 24), 1 + position, np.float32))
    whole, seen = os.replace, []

    def killed(source: Path, target: Path) -> None:
        if Path(target).parent == store.path and Path(source).is_dir():
            seen.append(target)
            if len(seen) > renamed:
                raise KeyboardInterrupt
        whole(source, target)

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        FrameStore.create(store.path, OBSERVED, range(0, 5), 20, 24)
    monkeypatch.setattr(os, "replace", whole)
    again = FrameStore.create(store.path, OBSERVED, range(0, 5), 20, 24)
    assert held(again, range(5)) == {1: 1.0, 2: 2.0, 3: 3.0, 4: 4.0}


def test_another_size_of_frame_starts_anew(tmp_path: Path) -> None:
    store = FrameStore.create(tmp_path / "s.zarr", OBSERVED, range(2), 20, 24)
    store.write("observed", 0, np.ones((2, 20, 24), np.float32))
    assert held(FrameStore.create(store.path, OBSERVED, range(2), 20, 26), range(2)) == {}


SPOILED = {
    "cut at the end": lambda data: data[:-3],
    "half": lambda data: data[: len(data) // 2],
    "flipped in the index": lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
    "empty": lambda data: b"",
}


@pytest.mark.parametrize("how", SPOILED)
def test_a_damaged_shard_is_written_over(store: FrameStore, how: str) -> None:
    """Zarr reads the index of a shard before it replaces the shard."""
    store.write("observed", 1, frame(1))
    path = store.shard_path("observed", 1)
    path.write_bytes(SPOILED[how](path.read_bytes()))
    digest = store.write("observed", 1, frame(2))
    np.testing.assert_array_equal(store.read("observed", 1, digest), frame(2))


def test_an_exit_while_a_shard_is_written_is_an_error_and_no_wait_for_ever(tmp_path, monkeypatch) -> None:
    import sys

    from yesnt.io import store as module

    monkeypatch.setattr(module, "write_bytes", lambda path, data: sys.exit("why"))
    with pytest.raises(RuntimeError, match=r"sys\.exit\('why'\) while a shard was written"):
        zarr.create_array(module.DurableStore(tmp_path / "a.zarr"), shape=(2,), dtype="f4")
