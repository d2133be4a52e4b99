"""The frame store: one Zarr v3 array a channel, one shard a frame, one writer a shard.

Zarr cannot tell a frame that was computed from one that was lost: a missing or empty shard reads as fill value, and two
swapped shards pass every checksum. So a frame counts as done only if its record says so (io/records.py), and every read
is checked against the digest in that record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xxhash
import zarr
from numpy.typing import NDArray
from zarr.storage import LocalStore

from yesnt.core.errors import CorruptError
from yesnt.io.durable import link_file, retried, write_bytes
from yesnt.io.store_layout import ArrayForm, Extent, lay_out, shard_path


class DurableStore(LocalStore):
    """A local store whose files survive a power cut: Zarr's own renames atomically but never syncs."""

    async def set(self, key: str, value: Any) -> None:
        """Writes one value whole, synced and read back, before it gets its name.

        It blocks Zarr's event loop, on which nothing else waits: a worker writes one shard at a time.

        Raises:
            RuntimeError: `sys.exit` was called meanwhile. As SystemExit it would end the thread of Zarr's event loop,
                and the task would wait for it for ever.
        """
        path = Path(self.root) / key
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write_bytes(path, value.to_bytes())
        except SystemExit as error:
            raise RuntimeError(f"sys.exit({error.code!r}) while a shard was written") from error


class FrameStore:
    """Reads and writes whole frames by channel and position in the sequence.

    Args:
        path: folder of the store (`store.zarr`).
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def _array(self, name: str) -> zarr.Array:
        """An array of the store; opened anew only if its metadata have changed since."""
        folder = self.path / name
        try:
            metadata = retried((folder / "zarr.json").read_bytes)
        except FileNotFoundError as error:
            raise _corrupt(self.path, name, -1, "the array is not in the store") from error
        return _opened(str(folder), metadata)

    @classmethod
    def create(
        cls, path: Path, arrays: Mapping[str, ArrayForm], frames: Sequence[int], height: int, width: int
    ) -> FrameStore:
        """Lays the store out before any task runs; frames that are in it stay, at the positions of their numbers.

        Args:
            path: folder.
            arrays: array name -> channel name (`solve.0` holds the channel `material`), or channel name and rows of an
                array that holds a band of rows.
            frames: frame numbers of the shot, ascending.
            height: rows.
            width: columns.
        """
        lay_out(zarr.open_group(DurableStore(path), mode="a"), path, arrays, Extent(frames, height, width))
        return cls(path)

    def write(self, name: str, position: int, frame: NDArray[np.floating]) -> str:
        """Writes one whole frame `[C, H, W]`, its bytes read back before they get their name; returns its digest.

        Raises:
            ValueError: the shape is not a whole frame of this array.
            CorruptError: what was read back differs.
        """
        array = self._array(name)
        if frame.shape != array.shape[1:]:
            raise ValueError(f"{name}[{position}]: frame {frame.shape} is not a whole frame {array.shape[1:]}")
        values = np.ascontiguousarray(frame, dtype=array.dtype)
        self._put(array, name, position, values)
        return array_digest(values)

    def _put(self, array: zarr.Array, name: str, position: int, values: NDArray[Any]) -> None:
        """Writes a frame over whatever is there: Zarr reads an old shard's index first, and refuses a damaged one."""
        try:
            array[position] = values
        except (ValueError, RuntimeError, IndexError, KeyError):
            old = self.shard_path(name, position)
            if not old.exists():
                raise
            old.unlink()
            array[position] = values

    def link(self, source: str, name: str, position: int) -> None:
        """Makes a frame of one array that of another of the same form too, without reading or writing its pixels.

        Raises:
            ValueError: the arrays differ in form.
            CorruptError: the source has no such frame.
        """
        held, array = self._array(source), self._array(name)
        if (held.shape, held.dtype, held.chunks) != (array.shape, array.dtype, array.chunks):
            raise ValueError(f"{source} {held.shape} and {name} {array.shape} are not of one form")
        path = self.shard_path(name, position)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            link_file(self.shard_path(source, position), path)
        except FileNotFoundError as error:
            raise _corrupt(self.path, source, position, "its file is missing") from error

    def read(self, name: str, position: int, digest: str | None = None) -> NDArray[np.float32]:
        """Reads one frame `[C, H, W]`; with a digest, proves that it is the one that was committed.

        Raises:
            CorruptError: damaged, lost, or another frame's bytes.
        """
        array = self._array(name)
        try:
            values = retried(lambda: np.asarray(array[position]))
        except (ValueError, RuntimeError, OSError) as error:
            raise _corrupt(self.path, name, position, str(error)) from error
        if digest is not None and array_digest(values) != digest:
            raise _corrupt(self.path, name, position, "its content is not what was committed")
        return values

    def shard_path(self, name: str, position: int) -> Path:
        """The file that holds one frame."""
        return shard_path(self.path / name, position)


@lru_cache(maxsize=64)
def _opened(folder: str, metadata: bytes) -> zarr.Array:
    """Opening an array costs more than reading a small frame; its metadata are part of what it is remembered by."""
    del metadata
    return zarr.open_array(DurableStore(folder), mode="r+")


def array_digest(values: NDArray[Any]) -> str:
    """XXH3-128 over shape, type and bytes of a decoded array, hexadecimal.

    It tells damage and mix-ups, not forgery, at the memory's speed; a frame is digested at every write and read.
    """
    values = np.ascontiguousarray(values)
    digest = xxhash.xxh3_128(f"{values.shape}{values.dtype.str}".encode())
    digest.update(values.data)
    return digest.hexdigest()


def _corrupt(path: Path, name: str, position: int, why: str) -> CorruptError:
    return CorruptError(
        f"A stored frame is damaged ({why})",
        f"{path}, array {name}, position {position}",
        "the frame that was committed",
        "`yesnt verify SHOT --repair` makes it again",
    )
