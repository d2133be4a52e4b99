"""Writes EXRs byte by byte, for kinds that no library writes: subsampled channels, odd windows, odd attributes.

Uncompressed scan lines, one or more parts (openexr.com, "OpenEXR File Layout").
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

KINDS = {"uint32": 0, "float16": 1, "float32": 2}
LINE_ORDERS = {"increasing": 0, "decreasing": 1, "random": 2}

Box = tuple[int, int, int, int]
"""Left, top, right, bottom, inclusive."""


@dataclass(frozen=True)
class Raw:
    """One part.

    Attributes:
        planes: channel -> [rows, columns] as stored; a subsampled channel has fewer.
        data: data window; None: the size of the first plane, at the origin.
        display: display window; None: the data window.
        sampling: channel -> (x, y) where it is not (1, 1).
        order: of the lines, one of `LINE_ORDERS`.
        aspect: pixel aspect ratio.
        attributes: name -> (type, bytes) to add.
        name: of the part, where the file has several.
        deep: stored as deep scan lines of one sample a pixel.
    """

    planes: Mapping[str, np.ndarray]
    data: Box | None = None
    display: Box | None = None
    sampling: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    order: str = "increasing"
    aspect: float = 1.0
    attributes: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    name: str = ""
    deep: bool = False

    @property
    def window(self) -> Box:
        """The data window."""
        if self.data is not None:
            return self.data
        height, width = next(iter(self.planes.values())).shape
        return 0, 0, width - 1, height - 1

    @property
    def lines(self) -> int:
        """Rows of the data window."""
        return max(0, self.window[3] - self.window[1] + 1)

    def header(self, multipart: bool) -> bytes:
        """All attributes and the closing byte."""
        channels = b"".join(
            name.encode() + b"\0" + struct.pack("<iBxxxii", KINDS[str(p.dtype)], 0, *self.sampling.get(name, (1, 1)))
            for name, p in sorted(self.planes.items())
        )
        entries: dict[str, tuple[str, bytes]] = {
            "channels": ("chlist", channels + b"\0"),
            "compression": ("compression", b"\0"),
            "dataWindow": ("box2i", struct.pack("<4i", *self.window)),
            "displayWindow": ("box2i", struct.pack("<4i", *(self.display or self.window))),
            "lineOrder": ("lineOrder", bytes([LINE_ORDERS[self.order]])),
            "pixelAspectRatio": ("float", struct.pack("<f", self.aspect)),
            "screenWindowCenter": ("v2f", struct.pack("<2f", 0, 0)),
            "screenWindowWidth": ("float", struct.pack("<f", 1)),
            **self.attributes,
        }
        if multipart or self.deep:
            kind = b"deepscanline" if self.deep else b"scanlineimage"
            entries |= {"type": ("string", kind), "chunkCount": ("int", struct.pack("<i", self.lines))}
        if multipart:
            entries["name"] = ("string", self.name.encode())
        if self.deep:
            entries |= {name: ("int", struct.pack("<i", 1)) for name in ("version", "maxSamplesPerPixel")}
        return b"".join(_attribute(name, *value) for name, value in entries.items()) + b"\0"

    def chunk(self, y: int) -> bytes:
        """One scan line: its number, its size, and the channels in alphabetical order."""
        left, top, right, _ = self.window
        rows = []
        for name, plane in sorted(self.planes.items()):
            across, down = self.sampling.get(name, (1, 1))
            if y % down == 0:
                row = len([v for v in range(top, y) if v % down == 0])
                columns = len([x for x in range(left, right + 1) if x % across == 0])
                rows.append(np.ascontiguousarray(plane[row, :columns]).tobytes())
        data = b"".join(rows)
        if self.deep:
            counts = np.arange(1, right - left + 2, dtype=np.int32).tobytes()
            return struct.pack("<i3Q", y, len(counts), len(data), len(data)) + counts + data
        return struct.pack("<ii", y, len(data)) + data

    def order_of_lines(self) -> Sequence[int]:
        """Numbers of the scan lines as they lie in the file."""
        lines = range(self.window[1], self.window[1] + self.lines)
        return {"increasing": lines, "decreasing": lines[::-1]}.get(self.order, [*lines[1::2], *lines[::2]])


def write_raw(path: Path, *parts: Raw) -> None:
    """Writes a file of one or more parts."""
    several = len(parts) > 1
    flags = (0x1000 if several else 0) | (0x800 if any(part.deep for part in parts) else 0) | 0x400
    head = struct.pack("<ii", 20000630, 2 | flags)
    head += b"".join(part.header(several) for part in parts) + (b"\0" if several else b"")
    position = len(head) + 8 * sum(part.lines for part in parts)
    tables, body = b"", b""
    for number, part in enumerate(parts):
        offsets: dict[int, int] = {}
        for y in part.order_of_lines():
            chunk = (struct.pack("<i", number) if several else b"") + part.chunk(y)
            offsets[y] = position + len(body)
            body += chunk
        tables += struct.pack(f"<{len(offsets)}Q", *(offsets[y] for y in sorted(offsets)))
    path.write_bytes(head + tables + body)


def string_vector(*words: str) -> tuple[str, bytes]:
    """The value of an attribute of strings, such as `multiView`."""
    return "stringvector", b"".join(struct.pack("<i", len(word)) + word.encode() for word in words)


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


LEVELS = {"one": 0, "mip": 1, "rip": 2}


def write_tiled(path: Path, plane: np.ndarray, side: int, levels: str = "one", missing: int = 0) -> None:
    """Writes the channels R, G, B of one square plane, whose side is a power of 2, in tiles of `side`.

    Args:
        path: the file.
        plane: [N, N] float32; smaller levels hold -1 everywhere.
        side: of a tile.
        levels: one of `LEVELS`.
        missing: so many tiles at the end of the file are not there, and their offsets are 0.
    """
    sizes = [len(plane) >> n for n in range(len(plane).bit_length())]
    chosen = {"one": [(0, 0)], "mip": [(n, n) for n in range(len(sizes))]}.get(levels)
    chosen = chosen or [(x, y) for y in range(len(sizes)) for x in range(len(sizes))]
    tiles = struct.pack("<IIB", side, side, LEVELS[levels])
    part = Raw(dict.fromkeys("RGB", plane), attributes={"tiles": ("tiledesc", tiles)}, order="increasing")
    chunks = []
    for level_x, level_y in chosen:
        width, height = sizes[level_x], sizes[level_y]
        seen = plane if (level_x, level_y) == (0, 0) else np.full((height, width), -1, np.float32)
        for y in range(0, height, side):
            for x in range(0, width, side):
                rows = seen[y : y + side, x : x + side]
                data = b"".join(row.tobytes() * 3 for row in rows)
                chunks.append(struct.pack("<5i", x // side, y // side, level_x, level_y, len(data)) + data)
    head = struct.pack("<ii", 20000630, 2 | 0x200) + part.header(False)
    kept = len(chunks) - missing
    starts = np.cumsum([len(head) + 8 * len(chunks), *map(len, chunks[:-1])])
    offsets = [int(start) if i < kept else 0 for i, start in enumerate(starts)]
    path.write_bytes(head + struct.pack(f"<{len(offsets)}Q", *offsets) + b"".join(chunks[:kept]))
