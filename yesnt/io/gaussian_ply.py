"""Gaussian fields as PLY files: the layout of 3D Gaussian Splatting, as Inria's code, gsplat, nerfstudio and GOF write.

Properties of each vertex, float32: x, y, z; f_dc_0..2; f_rest_* with all coefficients of red first, then green, then
blue; opacity (logit); scale_0..2 (natural logarithm); rot_0..3 (w, x, y, z); nx, ny, nz are ignored. Gaussian Opacity
Fields adds `filter_3D`, the standard deviation of its smoothing filter.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.gaussians.field import COUNTS, GaussianField
from yesnt.io.durable import write_bytes

MAX_FIELD_BYTES = 1 << 33
MAX_HEADER_BYTES = 1 << 16

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}

PACKED = {
    "packed_position": "PlayCanvas' compressed PLY",
    "f_dc_index": "a codebook PLY",
    "sh_idx": "a codebook PLY",
}
"""Properties of variants that are not read, and what they belong to."""

OTHER_FILES = {
    ".splat": "antimatter15's .splat", ".spz": "Niantic's .spz", ".sog": "PlayCanvas' .sog",
    ".ksplat": "mkkellogg's .ksplat",
}  # fmt: skip
"""Compressed formats by suffix."""

_SPACES = {"srgb": "srgb", "linear": "linear"}
_SPACE = "yesnt color_space "
"""Comment that says in which space colours are stored; files of other programs have none and hold sRGB."""

_LONGEST_NORM = 1e-6


def read_field(path: Path) -> GaussianField:
    """Reads a field.

    Raises:
        JobError: missing, too large, no PLY of Gaussians, a compressed or quantised variant (named), or damaged.
    """
    if path.suffix.lower() in OTHER_FILES:
        raise _packed(path, OTHER_FILES[path.suffix.lower()])
    try:
        if path.stat().st_size > MAX_FIELD_BYTES:
            raise JobError("The Gaussian field is too large", str(path), f"at most {MAX_FIELD_BYTES} bytes", "prune it")
        with path.open("rb") as stream:
            header = _Header(stream, path)
            columns = header.columns(stream)
    except FileNotFoundError as error:
        raise JobError(
            "The Gaussian field is missing", str(path), "a PLY file of 3D Gaussian Splatting",
            "check `gaussians.path` and the frame range",
        ) from error  # fmt: skip
    try:
        return _field(columns, header.space, path)
    except JobError as error:
        if str(path) in error.where:
            raise
        raise JobError(error.what, f"{path}: {error.where}", error.expected, error.do) from error


def write_field(path: Path, field: GaussianField) -> None:
    """Writes a field in Inria's layout, with `filter_3D` if it has a smoothing filter; whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, field_bytes(field))


def field_bytes(field: GaussianField) -> bytes:
    """The PLY file of a field."""
    rest = field.harmonics[:, 1:].transpose(0, 2, 1).reshape(field.count, -1)
    parts = {
        ("x", "y", "z"): field.positions,
        ("nx", "ny", "nz"): np.zeros((field.count, 3), np.float32),
        ("f_dc_0", "f_dc_1", "f_dc_2"): field.harmonics[:, 0],
        tuple(f"f_rest_{i}" for i in range(rest.shape[1])): rest,
        ("opacity",): field.opacity_logits[:, None],
        ("scale_0", "scale_1", "scale_2"): field.log_scales,
        ("rot_0", "rot_1", "rot_2", "rot_3"): field.rotations,
    }
    if field.filter_3d is not None:
        parts[("filter_3D",)] = field.filter_3d[:, None]
    names = [name for group in parts for name in group]
    comment = "" if field.color_space == "srgb" else f"comment {_SPACE}{field.color_space}\n"
    properties = "".join(f"property float {name}\n" for name in names)
    header = f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {field.count}\n{properties}end_header\n"
    table = np.concatenate(list(parts.values()), axis=1).astype("<f4")
    return header.encode() + table.tobytes()


class _Header:
    """The header of a PLY file; leaves the stream where its data begin."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self._path, self.space = path, "srgb"
        self.count, self._names, self._kinds = -1, list[str](), list[str]()
        lines = self._lines(stream)
        self._format = lines[1].split()[1] if len(lines) > 1 and lines[1].startswith("format ") else ""
        element = ""
        for line in lines[2:]:
            words = line.split()
            if line.startswith(f"comment {_SPACE}"):
                self.space = _SPACES.get(words[-1], words[-1])
            elif words[:1] == ["element"] and len(words) == 3:
                element = words[1]
                self._refuse_element(element)
                self.count = int(words[2]) if words[2].isdigit() else -1
            elif words[:1] == ["property"] and element == "vertex" and len(words) == 3:
                self._kinds.append(words[1])
                self._names.append(words[2])
        self._check()

    def _lines(self, stream: BinaryIO) -> list[str]:
        lines, size = list[str](), 0
        while not lines or lines[-1] != "end_header":
            line = stream.readline(MAX_HEADER_BYTES)
            size += len(line)
            if not line or size > MAX_HEADER_BYTES or (not lines and line.strip() != b"ply"):
                raise self._wrong("It has no header of a PLY file")
            lines.append(line.decode("ascii", "replace").strip())
        return lines

    def _refuse_element(self, name: str) -> None:
        if name in ("chunk", "codebook_centers"):
            raise _packed(self._path, "PlayCanvas' compressed PLY" if name == "chunk" else "a codebook PLY")
        if name != "vertex" or self._names:
            raise self._wrong(f"It has an element {name!r} beside its vertices")

    def _check(self) -> None:
        for name, variant in PACKED.items():
            if name in self._names:
                raise _packed(self._path, variant)
        if self.count < 0 or self._format not in (*_BYTE_ORDERS, "ascii") or not self._names:
            raise self._wrong("Its header says neither format nor vertices")
        unknown = [kind for kind in self._kinds if kind not in _TYPES]
        if unknown or len(set(self._names)) < len(self._names):
            raise self._wrong(f"Its vertices have properties that cannot be read ({', '.join(unknown) or 'twice'})")
        quantised = [
            n for n, kind in zip(self._names, self._kinds, strict=True) if n in _NEEDED and kind[0] not in "fd"
        ]
        if quantised:
            raise _packed(self._path, f"a quantised PLY ({quantised[0]} is an integer)")

    def columns(self, stream: BinaryIO) -> dict[str, NDArray[np.float32]]:
        """Every property [N] by name."""
        kinds = [_TYPES[kind] for kind in self._kinds]
        if self._format == "ascii":
            text = io.StringIO(stream.read().decode("ascii", "replace"))
            table = np.loadtxt(text, dtype=np.float64, ndmin=2, max_rows=self.count)
            if table.shape != (self.count, len(kinds)):
                raise self._wrong(f"It holds {len(table)} of {self.count} Gaussians")
            return {name: table[:, i].astype(np.float32) for i, name in enumerate(self._names)}
        order = _BYTE_ORDERS[self._format]
        row = np.dtype([(name, order + kind) for name, kind in zip(self._names, kinds, strict=True)])
        data = stream.read(row.itemsize * self.count)
        if len(data) != row.itemsize * self.count:
            raise self._wrong(f"It ends after {len(data) // row.itemsize} of {self.count} Gaussians")
        values = np.frombuffer(data, row)
        return {name: values[name].astype(np.float32) for name in self._names}

    def _wrong(self, why: str) -> JobError:
        return JobError(
            f"The Gaussian field cannot be read. {why}", str(self._path), "a PLY file of 3D Gaussian Splatting",
            "export it as Inria's code, gsplat, nerfstudio or Gaussian Opacity Fields do",
        )  # fmt: skip


def _packed(path: Path, variant: str) -> JobError:
    return JobError(
        f"The Gaussian field is {variant}, which is compressed or quantised", str(path),
        "a PLY with the float properties x, f_dc_0, opacity, scale_0, rot_0",
        "export it uncompressed, or convert it with the program that packed it",
    )  # fmt: skip


_NEEDED = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
           "rot_0", "rot_1", "rot_2", "rot_3")  # fmt: skip


def _field(columns: dict[str, NDArray[np.float32]], space: str, path: Path) -> GaussianField:
    absent = [name for name in _NEEDED if name not in columns]
    if absent:
        flat = "scale_2" in absent and "scale_0" in columns
        raise JobError(
            f"The Gaussian field has no {absent[0]}", str(path),
            "three scales a Gaussian" if flat else f"the properties {', '.join(_NEEDED)}",
            "fit it with 3D Gaussians: this is a field of flat discs (2DGS)" if flat else "is it a point cloud?",
        )  # fmt: skip

    def stacked(*names: str) -> NDArray[np.float32]:
        return np.stack([columns[name] for name in names], axis=1)

    numbers = sorted(int(name[7:]) for name in columns if re.fullmatch(r"f_rest_\d+", name))
    count = len(numbers) // 3 + 1
    if numbers != list(range(len(numbers))) or len(numbers) % 3 or count not in COUNTS:
        raise JobError(
            f"The Gaussian field has {len(numbers)} properties f_rest_*", str(path),
            "0, 9, 24 or 45: spherical harmonics of degree 0 to 3", "export it again",
        )  # fmt: skip
    harmonics = stacked("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    if numbers:
        rest = stacked(*(f"f_rest_{i}" for i in numbers)).reshape(-1, 3, count - 1)
        harmonics = np.concatenate([harmonics, rest.transpose(0, 2, 1)], axis=1)
    rotations = stacked("rot_0", "rot_1", "rot_2", "rot_3")
    length = np.linalg.norm(rotations, axis=1, keepdims=True)
    rotations = np.where(np.abs(length - 1) > _LONGEST_NORM, rotations / np.maximum(length, 1e-20), rotations)
    return GaussianField(
        stacked("x", "y", "z"), stacked("scale_0", "scale_1", "scale_2"), rotations, columns["opacity"], harmonics,
        columns.get("filter_3D"), space,  # type: ignore[arg-type]
    )  # fmt: skip
