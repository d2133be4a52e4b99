"""What picture files say of their colours, and the spaces that this means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color_spaces import (
    INTEROP_OF,
    LIN_REC709,
    NAMED_BY_INTEROP,
    SRGB,
    Conversion,
    matrix_to_rec709,
    same_space,
    space_of_chromaticities,
)
from yesnt.core.errors import JobError
from yesnt.io.color_config import ColorConfig, convert, fresh_config
from yesnt.io.pictures.image import ImageHeader

Float64 = NDArray[np.float64]

_FLOAT = {"half", "float", "double"}

PROBES = np.array([[1, 1, 1], [0.18, 0.4, 0.05], [0.9, 0.2, 0.7], [0.02, 0.5, 0.1]], np.float32)
"""Colours [4, 3] by which spaces are compared."""


@dataclass(frozen=True)
class Statement:
    """What a file says of its colours.

    Attributes:
        interop: identifier of the space (`colorInteropID`); "" if the file has none.
        chromaticities: red, green, blue, white x, y; () if the file has none.
        integer: pixels are integers, as of pictures made for a display.
        decoder: what OpenImageIO derives from the format for integer pixels: an interop identifier, another word or "".
    """

    interop: str = ""
    chromaticities: tuple[float, ...] = ()
    integer: bool = False
    decoder: str = ""

    @classmethod
    def of(cls, header: ImageHeader) -> Statement:
        """The statement of a header."""
        stated = header.attributes
        integer = header.format != "openexr" and not set(header.kinds) <= _FLOAT
        interop, found = str(stated.get("colorInteropID") or ""), stated.get("chromaticities")
        chromaticities = tuple(float(v) for v in found) if isinstance(found, Sequence) else ()
        decoder = str(stated.get("oiio:ColorSpace") or "") if integer else ""
        return cls("" if interop in ("unknown", "data") else interop, chromaticities, integer, decoder)

    @property
    def text(self) -> str:
        """How messages name it."""
        if self.interop:
            return f"colorInteropID {self.interop}"
        if self.chromaticities:
            return f"chromaticities {', '.join(f'{v:g}' for v in self.chromaticities)}"
        return f"integers{f' as {self.decoder}' if self.decoder else ''}" if self.integer else "no colour space"


class StatedSpaces:
    """The spaces that files state, under one configuration, which is opened only if it is needed.

    Args:
        config: path or `ocio://` name.

    Attributes:
        notes: lines that tell what was taken from files.
    """

    def __init__(self, config: str) -> None:
        self._path = config
        self.notes: list[str] = []

    @cached_property
    def config(self) -> ColorConfig:
        """The configuration, as it is on disk now."""
        return fresh_config(self._path)

    def conversion(self, source: str, target: str) -> Conversion:
        """A conversion between two canonical names; our own need no configuration."""
        if {source, target} <= {LIN_REC709, SRGB}:  # our own arithmetic
            return Conversion(source, target)
        return self.config.conversion(source, target)

    def canonical(self, name: str, key: str) -> str:
        """The canonical name; our own names need no configuration."""
        own = NAMED_BY_INTEROP.get(name, name.casefold())
        return own if own in NAMED_BY_INTEROP.values() else self.config.canonical(name, f"key {key}")

    def stated(self, statement: Statement, role: str, path: Path) -> str:
        """The space that a file states; else sRGB for integers, and linear Rec.709.

        Raises:
            JobError: it contradicts itself, or states a space that is not known.
        """
        if statement.interop:
            space = self.canonical(statement.interop, f"{path}, colorInteropID")
            self.compare(space, Statement(chromaticities=statement.chromaticities), role, path)
        elif statement.chromaticities:
            space = self.canonical(_linear_space(statement, role, path), str(path))
        elif statement.integer:
            return self._integer_space(statement, role, path)
        else:
            return LIN_REC709
        if space != LIN_REC709:
            self.notes.append(f"{role}: read as {space}, as its files say ({statement.text})")
        return space

    def _integer_space(self, statement: Statement, role: str, path: Path) -> str:
        """The space of integer pixels, where the job says nothing: sRGB, or what the format's own fields say."""
        space = NAMED_BY_INTEROP.get(statement.decoder or INTEROP_OF[SRGB], statement.decoder)
        if space not in NAMED_BY_INTEROP.values() and not space.endswith("_scene"):
            raise JobError(
                f"The {role} is encoded as {space}, and the job does not say in which colour space", str(path),
                f"`colorspace` in the section `{role}`", "name the space, for example a camera's log space",
            )  # fmt: skip
        space = self.canonical(space, f"{role}.colorspace")
        said = "no colour space is stated" if space == SRGB else "the job states no colour space"
        self.notes.append(f"{role}: {said}; the integers of {path.name} are read as {space}")
        return space

    def compare(self, space: str, statement: Statement, role: str, path: Path) -> None:
        """Refuses a file that says another space than the job.

        Raises:
            JobError: as said.
        """
        differs = bool(statement.interop) and not self._same(space, self.canonical(statement.interop, str(path)))
        if statement.chromaticities and not differs:
            differs = not same_space(_matrix(statement, role, path), self._primaries(space))
        if differs:
            raise JobError(
                f"The {role} says of itself {statement.text}, which is not {space}", str(path),
                f"files that agree with `{role}.colorspace`",
                f"correct that key or remove it (the files' own space is then used); if the files are wrong, "
                f"remove the attribute: `oiiotool {path.name} --eraseattrib \"chromaticities|colorInteropID\" -o ...`",
            )  # fmt: skip

    def _same(self, one: str, other: str) -> bool:
        """Whether colours mean the same in two spaces."""
        if one == other:
            return True
        here, there = (convert(PROBES, self.conversion(space, LIN_REC709)) for space in (one, other))
        return bool(np.allclose(here, there, rtol=1e-2, atol=1e-3))

    def _primaries(self, space: str) -> Float64:
        """Matrix [3, 3] to linear Rec.709 of a space's primaries, whatever its transfer function; white is 1."""
        corners = np.concatenate([np.eye(3, dtype=np.float32), np.ones((1, 3), np.float32)])
        seen = convert(corners, self.conversion(space, LIN_REC709)).astype(np.float64)
        return np.asarray(seen[:3].T / seen[3].mean())


def _matrix(statement: Statement, role: str, path: Path) -> Float64:
    """Matrix [3, 3] to linear Rec.709 of a file's chromaticities.

    Raises:
        JobError: they span no colour space.
    """
    try:
        return matrix_to_rec709(statement.chromaticities)
    except ValueError as error:
        raise _no_space(statement, role, path, str(error)) from error


def _linear_space(statement: Statement, role: str, path: Path) -> str:
    """Interop identifier of the linear space that a file's chromaticities mean.

    Raises:
        JobError: they are of no space that has a name.
    """
    _matrix(statement, role, path)
    found = space_of_chromaticities(statement.chromaticities)
    if found is None:
        raise _no_space(statement, role, path, "they are of no space that is known")
    return found


def _no_space(statement: Statement, role: str, path: Path, why: str) -> JobError:
    return JobError(
        f"The {role} has {statement.text}, and {why}", str(path),
        "those of Rec.709, ACEScg, ACES2065-1, P3-D65, Rec.2020 or Adobe RGB",
        f"name the space in `{role}.colorspace` of the job, with a configuration that defines it",
    )  # fmt: skip
