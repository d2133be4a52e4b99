"""Finds a job's colour conversions: what the job says of each input, compared with what the files say of themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color_spaces import (
    INTEROP_OF,
    LIN_REC709,
    NAMED_BY_INTEROP,
    PRIMARIES,
    SRGB,
    Conversion,
    JobColors,
    OutputSpace,
    chromaticities_of,
    matrix_to_rec709,
    same_space,
    space_of_chromaticities,
)
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, PlateInput, Shot
from yesnt.io.color_config import ColorConfig, convert, fresh_config, locate_config
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.image import ImageHeader, read_headers
from yesnt.io.pictures.passes import find_color

Float64 = NDArray[np.float64]

ROLES = ("plate", "background", "light", "capture_light")
"""Sections of the job file whose pictures have colours."""

_FLOAT = {"half", "float", "double"}

_PROBES = np.array([[1, 1, 1], [0.18, 0.4, 0.05], [0.9, 0.2, 0.7], [0.02, 0.5, 0.1]], np.float32)


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


def resolve_colors(shot: Shot, root: str, frames: Sequence[int]) -> tuple[Shot, JobColors, tuple[str, ...]]:
    """A job's spaces under their canonical names, its conversions, and lines that tell what was taken from the files.

    Raises:
        JobError: an unknown space or view, a file that contradicts the job, or a configuration that cannot be used.
    """
    return _Resolver(shot, root, frames[0]).resolve()


def first_statements(job: Job) -> dict[str, Statement]:
    """What the first frame's files say of their colours, by role."""
    patterns, first = _patterns(job.shot), job.frames[0]
    return {role: _statement(frame_path(job.root, path, first), job.shot, role) for role, path in patterns.items()}


def check_statement(path: Path, shot: Shot, role: str, first: Statement) -> None:
    """Refuses a file that says something else of its colours than the first of its sequence.

    Raises:
        JobError: as said.
    """
    if (found := _statement(path, shot, role)) != first:
        raise JobError(
            f"The pictures of the {role} differ in what they say of their colours", str(path),
            f"{first.text}, as in the first frame; this one has {found.text}", "export all frames in one colour space",
        )  # fmt: skip


def _statement(path: Path, shot: Shot, role: str) -> Statement:
    """What the part of a file that holds the colour says of it."""
    section = getattr(shot, role)
    spec = section if isinstance(section, PlateInput) else PlateInput(path=str(path))
    return Statement.of(find_color(read_headers(path), spec, role).color[0].header)


def _patterns(shot: Shot) -> Mapping[str, str]:
    sections = {role: getattr(shot, role) for role in ROLES}
    return {role: section.path for role, section in sections.items() if section is not None and section.path}


class _Resolver:
    """Resolves the spaces of one job; the configuration is opened only if it is needed."""

    def __init__(self, shot: Shot, root: str, first: int) -> None:
        self._shot, self._root, self._first = shot, root, first
        self._notes: list[str] = []

    @cached_property
    def config(self) -> ColorConfig:
        """The job's configuration, as it is on disk now."""
        return fresh_config(locate_config(self._root, self._shot.color.config))

    def resolve(self) -> tuple[Shot, JobColors, tuple[str, ...]]:
        """See `resolve_colors`."""
        shot, color = self._shot, self._shot.color
        spaces = {role: self._input_space(role, pattern) for role, pattern in _patterns(shot).items()}
        sections = {role: getattr(shot, role).model_copy(update={"colorspace": spaces[role]}) for role in spaces}
        output = self._output_space()
        inputs = {role: self._conversion(space, color.working) for role, space in spaces.items() if role != "plate"}
        colors = JobColors(
            plate=self._conversion(spaces["plate"], LIN_REC709),
            plate_working=self._conversion(spaces["plate"], color.working),
            output=self._conversion(color.working, output.name),
            display=self._display(output.name),
            output_space=output,
            **inputs,
        )
        found = shot.model_copy(update={**sections, "color": color.model_copy(update={"output": output.name})})
        return found, colors, tuple(self._notes)

    def _conversion(self, source: str, target: str) -> Conversion:
        if {source, target} <= {LIN_REC709, SRGB}:  # our own arithmetic
            return Conversion(source, target)
        return self.config.conversion(source, target)

    def _canonical(self, name: str, key: str) -> str:
        """The canonical name; our own names need no configuration."""
        own = NAMED_BY_INTEROP.get(name, name.casefold())
        return own if own in NAMED_BY_INTEROP.values() else self.config.canonical(name, f"key {key}")

    def _input_space(self, role: str, pattern: str) -> str:
        """The space of a sequence: what the job says, which the files must not contradict, or what the files say."""
        section, path = getattr(self._shot, role), frame_path(self._root, pattern, self._first)
        statement = _statement(path, self._shot, role)
        if "colorspace" in section.model_fields_set:
            space = self._canonical(section.colorspace, f"{role}.colorspace")
            self._compare(space, statement, role, path)
            return space
        return self._stated_space(statement, role, path)

    def _stated_space(self, statement: Statement, role: str, path: Path) -> str:
        """The space that a file states; else sRGB for integers, and linear Rec.709."""
        if statement.interop:
            space = self._canonical(statement.interop, f"{path}, colorInteropID")
            self._compare(space, Statement(chromaticities=statement.chromaticities), role, path)
        elif statement.chromaticities:
            space = self._canonical(_linear_space(statement, role, path), str(path))
        elif statement.integer:
            return self._integer_space(statement, role, path)
        else:
            return LIN_REC709
        if space != LIN_REC709:
            self._notes.append(f"{role}: read as {space}, as its files say ({statement.text})")
        return space

    def _integer_space(self, statement: Statement, role: str, path: Path) -> str:
        """The space of integer pixels, where the job says nothing: sRGB, or what the format's own fields say."""
        space = NAMED_BY_INTEROP.get(statement.decoder or INTEROP_OF[SRGB], statement.decoder)
        if space not in NAMED_BY_INTEROP.values() and not space.endswith("_scene"):
            raise JobError(
                f"The {role} is encoded as {space}, and the job does not say in which colour space", str(path),
                f"`colorspace` in the section `{role}`", "name the space, for example a camera's log space",
            )  # fmt: skip
        space = self._canonical(space, f"{role}.colorspace")
        said = "no colour space is stated" if space == SRGB else "the job states no colour space"
        self._notes.append(f"{role}: {said}; the integers of {path.name} are read as {space}")
        return space

    def _compare(self, space: str, statement: Statement, role: str, path: Path) -> None:
        """Refuses a file that says another space than the job.

        Raises:
            JobError: as said.
        """
        differs = bool(statement.interop) and not self._same(space, self._canonical(statement.interop, str(path)))
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
        here, there = (convert(_PROBES, self._conversion(space, LIN_REC709)) for space in (one, other))
        return bool(np.allclose(here, there, rtol=1e-2, atol=1e-3))

    def _primaries(self, space: str) -> Float64:
        """Matrix [3, 3] to linear Rec.709 of a space's primaries, whatever its transfer function; white is 1."""
        corners = np.concatenate([np.eye(3, dtype=np.float32), np.ones((1, 3), np.float32)])
        seen = convert(corners, self._conversion(space, LIN_REC709)).astype(np.float64)
        return np.asarray(seen[:3].T / seen[3].mean())

    def _output_space(self) -> OutputSpace:
        """The space of the EXRs.

        Raises:
            JobError: it is not linear: layers would no longer add up, nor alpha cover.
        """
        name = self._canonical(self._shot.color.output, "color.output")
        interop = INTEROP_OF.get(name, "")
        if interop in PRIMARIES:
            return OutputSpace(name, interop, PRIMARIES[interop])
        matrix = self._linear_matrix(name)
        if matrix is None:
            raise JobError(
                f"The output space {name} is not linear", "key color.output",
                "a scene-linear space such as lin_rec709 or ACEScg: in others layers do not add up",
                "name a linear space here; `color.view` is for pictures that are looked at",
            )  # fmt: skip
        known = next((one for one, own in PRIMARIES.items() if same_space(matrix, matrix_to_rec709(own))), "")
        return OutputSpace(name, known, PRIMARIES[known] if known else chromaticities_of(matrix))

    def _linear_matrix(self, name: str) -> Float64 | None:
        """Matrix [3, 3] of a space to linear Rec.709, found by converting colours; None if the space is not linear."""
        if name == SRGB:
            return None
        conversion = self._conversion(name, LIN_REC709)
        matrix = convert(np.eye(3, dtype=np.float32), conversion).astype(np.float64).T
        probes = np.concatenate([_PROBES, -0.1 * _PROBES, 30 * _PROBES, np.zeros((1, 3), np.float32)])
        seen = convert(probes, conversion)
        return matrix if np.allclose(seen, probes @ matrix.T, rtol=1e-4, atol=1e-4) else None

    def _display(self, output: str) -> Conversion:
        view = self._shot.color.view
        return self._conversion(output, SRGB) if view is None else self.config.view(output, view, "key color.view")


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
