"""Layout of the frame store's arrays: which there are, in which form, and which frame is stored at which position.

A shot whose range of frames changes keeps what it has computed: shards follow their frame numbers to new positions.
They are linked into a new array beside the old one, which then takes its name. A process that is killed in between
leaves the old array or the new one.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import zarr
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

from yesnt.core.channels import CHANNELS
from yesnt.core.frame_ranges import frame_ranges
from yesnt.io.durable import link_file, sync_folder
from yesnt.io.jobfile import parse_frames

ArrayForm = str | tuple[str, int]
"""A channel's name, or with it the rows of a band."""

_ZSTD_LEVEL = -1
"""Three times as fast as level 1, for shards that are a tenth larger: float noise hardly shrinks, empty pixels do."""

_ROWS = 256
"""Most rows of an inner chunk, which holds all components at full width. A solver reads bands of rows without decoding
whole frames; a small frame is one or two chunks, since Zarr's own work for a chunk costs more than coding 100 kB."""

_NEW, _OLD = ".relaid", ".former"
"""Suffixes of an array while its shards move."""


@dataclass(frozen=True)
class Extent:
    """Frame numbers of the shot in ascending order, and the size of a frame in pixels."""

    frames: Sequence[int]
    height: int
    width: int


def lay_out(group: zarr.Group, folder: Path, arrays: Mapping[str, ArrayForm], extent: Extent) -> None:
    """Creates arrays that are missing, moves shards whose position has changed, and keeps what is in place.

    Args:
        group: the store's root group.
        folder: the store's folder.
        arrays: array name -> its form.
        extent: frames and their size.
    """
    text = frame_ranges(extent.frames)
    for name, form in arrays.items():
        _finish_move(folder / name)
        shape = _shape(form, extent)
        existing = group[name] if name in group else None
        held = getattr(existing, "shape", None), None if existing is None else existing.attrs.get("frames")
        if held == (shape, text):
            continue
        movable = held[0] is not None and held[0][1:] == shape[1:] and isinstance(held[1], str)
        _create(group, name + _NEW if movable else name, form, shape, text)
        if movable:
            _move(folder / name, parse_frames(str(held[1]), str(folder / name)), extent.frames)


def shard_path(array: Path, position: int) -> Path:
    """The file that holds one frame of an array."""
    return array / "c" / str(position) / "0" / "0" / "0"


def chunk_rows(height: int) -> int:
    """Rows of an inner chunk: as few equal chunks as `_ROWS` allows, so that a shard has next to no padding."""
    return -(-height // -(-height // _ROWS))


def _shape(form: ArrayForm, extent: Extent) -> tuple[int, int, int, int]:
    """(frames, components, rows, columns) of an array."""
    channel, rows = (form, extent.height) if isinstance(form, str) else form
    return len(extent.frames), CHANNELS[channel].components, rows, extent.width


def _create(group: zarr.Group, name: str, form: ArrayForm, shape: tuple[int, int, int, int], frames: str) -> None:
    """An empty array; one of this name is replaced."""
    channel = CHANNELS[form if isinstance(form, str) else form[0]]
    _, components, height, width = shape
    rows = chunk_rows(height)
    group.create_array(
        name,
        shape=shape,
        dtype=channel.dtype,
        shards=(1, components, rows * -(-height // rows), width),
        chunks=(1, components, rows, width),
        serializer=BytesCodec(endian="little"),
        compressors=(ZstdCodec(level=_ZSTD_LEVEL), Crc32cCodec()),
        fill_value=float("nan"),
        config={"write_empty_chunks": True},
        dimension_names=("frame", "component", "y", "x"),
        attributes={"unit": channel.unit, "space": channel.space, "frames": frames},
        overwrite=True,
    )


def _move(array: Path, former: Sequence[int], frames: Sequence[int]) -> None:
    """Links the shards of frames that stay into the new array, and gives it the name of the old one."""
    relaid = array.with_name(array.name + _NEW)
    place = {frame: position for position, frame in enumerate(former)}
    for position, frame in enumerate(frames):
        source = shard_path(array, place[frame]) if frame in place else None
        if source is not None and source.exists():
            target = shard_path(relaid, position)
            target.parent.mkdir(parents=True, exist_ok=True)
            link_file(source, target)
    os.replace(array, array.with_name(array.name + _OLD))
    _finish_move(array)


def _finish_move(array: Path) -> None:
    """Ends a move that was interrupted: the new array is whole as soon as the old one has lost its name."""
    relaid, former = array.with_name(array.name + _NEW), array.with_name(array.name + _OLD)
    if former.exists() and not array.exists():
        os.replace(relaid, array)
        sync_folder(array.parent)
    for leftover in (former, relaid):
        if leftover.exists():
            shutil.rmtree(leftover)
