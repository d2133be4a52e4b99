import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yesnt.core.errors import CorruptError
from yesnt.io.store import FrameStore, array_digest

SHAPE = (2, 20, 24)


def frame(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(SHAPE, dtype=np.float32)


@pytest.fixture
def store(tmp_path: Path) -> FrameStore:
    return FrameStore.create(tmp_path / "s.zarr", {"observed": "observed"}, 3, 20, 24)


def test_a_frame_comes_back_exactly(store: FrameStore) -> None:
    digest = store.write("observed", 1, frame(1))
    np.testing.assert_array_equal(store.read("observed", 1, digest), frame(1))
    assert digest == array_digest(frame(1))


@pytest.mark.parametrize("size", [(1, 1), (255, 3), (256, 257), (300, 520)])
def test_every_size_is_one_shard_a_frame(tmp_path: Path, size: tuple[int, int]) -> None:
    store = FrameStore.create(tmp_path / "s.zarr", {"z": "z"}, 2, *size)
    values = np.random.default_rng(0).random((1, *size), dtype=np.float32)
    digest = store.write("z", 0, values)
    np.testing.assert_array_equal(store.read("z", 0, digest), values)
    assert [p for p in (tmp_path / "s.zarr" / "z" / "c").rglob("*") if p.is_file()] == [store.shard_path("z", 0)]


def test_partial_frames_are_refused(store: FrameStore) -> None:
    with pytest.raises(ValueError, match="is not a whole frame"):
        store.write("observed", 0, frame(0)[:, :4])


def test_creating_again_keeps_what_is_there(store: FrameStore) -> None:
    digest = store.write("observed", 0, frame(0))
    again = FrameStore.create(store.path, {"observed": "observed", "solve.0": "material"}, 3, 20, 24)
    np.testing.assert_array_equal(again.read("observed", 0, digest), frame(0))


@pytest.mark.parametrize("linkable", [True, False])
def test_a_frame_is_carried_over_without_its_pixels(
    store: FrameStore, linkable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(source: Path, path: Path) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    FrameStore.create(store.path, {"solve.0": "material", "solve.1": "material"}, 3, 20, 24)
    if not linkable:
        monkeypatch.setattr(os, "link", refuse)
    digest = store.write("solve.0", 1, frame(1))
    for _ in range(2):  # a task that is killed after it does it again
        store.link("solve.0", "solve.1", 1)
    store.write("solve.0", 1, frame(2))
    np.testing.assert_array_equal(store.read("solve.1", 1, digest), frame(1))
    assert [p for p in store.path.rglob("*") if ".partial" in p.name] == []


def test_only_frames_of_one_form_that_are_there_are_carried_over(store: FrameStore) -> None:
    FrameStore.create(store.path, {"solve.0": "material", "z": "z"}, 3, 20, 24)
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
    store = FrameStore.create(tmp_path_factory.mktemp("s") / "s.zarr", {"observed": "observed"}, 1, 20, 24)
    digest = store.write("observed", 0, frame(0))
    path = store.shard_path("observed", 0)
    data = bytearray(path.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    path.write_bytes(data)
    with pytest.raises(CorruptError):
        store.read("observed", 0, digest)
