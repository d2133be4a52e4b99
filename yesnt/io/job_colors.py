"""Finds a job's colour conversions: what the job says of each input, compared with what the files say of themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.files import pattern_file
from yesnt.core.capture_input import CAMERA
from yesnt.core.color_spaces import (
    INTEROP_OF,
    LIN_REC709,
    PRIMARIES,
    SRGB,
    Conversion,
    JobColors,
    OutputSpace,
    chromaticities_of,
    matrix_to_rec709,
    same_space,
)
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, PlateInput, Shot
from yesnt.io.cameras import cameras_of
from yesnt.io.color_config import convert, locate_config
from yesnt.io.color_statements import PROBES, StatedSpaces, Statement
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.image import read_headers
from yesnt.io.pictures.passes import find_color
from yesnt.io.video import is_video

Float64 = NDArray[np.float64]

ROLES = ("plate", "background", "light", "capture_light", "capture")
"""Sections of the job file whose pictures have colours."""


def resolve_colors(shot: Shot, root: str, frames: Sequence[int]) -> tuple[Shot, JobColors, tuple[str, ...]]:
    """A job's spaces under their canonical names, its conversions, and lines that tell what was taken from the files.

    Raises:
        JobError: an unknown space or view, a file that contradicts the job, or a configuration that cannot be used.
    """
    return _Resolver(shot, root, frames[0]).resolve()


def first_statements(job: Job) -> dict[str, Statement]:
    """What the first frame's files say of their colours, by role."""
    patterns, first = _patterns(job.shot, job.root), job.frames[0]
    files = {role: _first_file(job.root, role, path, first) for role, path in patterns.items()}
    return {role: _statement(path, job.shot, role) for role, path in files.items()}


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
    if is_video(path):
        return Statement(integer=True)  # what its stream says of matrix and range is undone when it is read
    section = getattr(shot, role)
    layer = getattr(section, "layer", None)
    spec = section if isinstance(section, PlateInput) else PlateInput(path=str(path), layer=layer)
    return Statement.of(find_color(read_headers(path), spec, role).color[0].header)


def _patterns(shot: Shot, root: str) -> Mapping[str, str]:
    """Patterns of the pictures by role; the first camera's speak for all cameras of the capture."""
    sections = {role: getattr(shot, role) for role in ROLES if role != "capture"}
    found = {role: section.path for role, section in sections.items() if section is not None and section.path}
    if shot.plate.path in shot.made:  # rendered in linear Rec.709 by the run itself, perhaps not yet
        del found["plate"]
    if (capture := shot.capture if shot.gaussians else shot.captured) is not None:
        first = next(iter(cameras_of(root, capture)))
        found["capture"] = capture.path.replace(CAMERA, first)
    return found


def _first_file(root: str, role: str, pattern: str, first: int) -> Path:
    """The file of a role's first frame; those of a capture may have the number in their folders."""
    return pattern_file(root, pattern, first) if role == "capture" else frame_path(root, pattern, first)


class _Resolver:
    """Resolves the spaces of one job."""

    def __init__(self, shot: Shot, root: str, first: int) -> None:
        self._shot, self._root, self._first = shot, root, first
        self._spaces = StatedSpaces(locate_config(root, shot.color.config))

    def resolve(self) -> tuple[Shot, JobColors, tuple[str, ...]]:
        """See `resolve_colors`."""
        shot, color = self._shot, self._shot.color
        spaces = {role: self._input_space(role, pattern) for role, pattern in _patterns(shot, self._root).items()}
        spaces.setdefault("plate", LIN_REC709)
        sections = {role: getattr(shot, role).model_copy(update={"colorspace": spaces[role]}) for role in spaces}
        output = self._output_space()
        inputs = {
            role: self._spaces.conversion(space, color.working) for role, space in spaces.items() if role != "plate"
        }
        colors = JobColors(
            plate=self._spaces.conversion(spaces["plate"], LIN_REC709),
            plate_working=self._spaces.conversion(spaces["plate"], color.working),
            output=self._spaces.conversion(color.working, output.name),
            display=self._display(output.name),
            output_space=output,
            **inputs,
            **self._scene(),
        )
        found = shot.model_copy(update={**sections, "color": color.model_copy(update={"output": output.name})})
        return found, colors, tuple(self._spaces.notes)

    def _scene(self) -> dict[str, Conversion]:
        """Conversions of the scene's pictures, and of its baked map; none without a scene."""
        if self._shot.scene is None:
            return {}
        working, light = self._shot.color.working, self._shot.light
        there, back = self._spaces.conversion(LIN_REC709, working), self._spaces.conversion(working, LIN_REC709)
        return {"scene": there, "to_scene": back, **({"light": there} if light.set else {})}

    def _input_space(self, role: str, pattern: str) -> str:
        """The space of a sequence: what the job says, which the files must not contradict, or what the files say."""
        section, path = getattr(self._shot, role), _first_file(self._root, role, pattern, self._first)
        statement = _statement(path, self._shot, role)
        if "colorspace" in section.model_fields_set:
            space = self._spaces.canonical(section.colorspace, f"{role}.colorspace")
            self._spaces.compare(space, statement, role, path)
            return space
        return self._spaces.stated(statement, role, path)

    def _output_space(self) -> OutputSpace:
        """The space of the EXRs.

        Raises:
            JobError: it is not linear: layers would no longer add up, nor alpha cover.
        """
        name = self._spaces.canonical(self._shot.color.output, "color.output")
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
        conversion = self._spaces.conversion(name, LIN_REC709)
        matrix = convert(np.eye(3, dtype=np.float32), conversion).astype(np.float64).T
        probes = np.concatenate([PROBES, -0.1 * PROBES, 30 * PROBES, np.zeros((1, 3), np.float32)])
        seen = convert(probes, conversion)
        return matrix if np.allclose(seen, probes @ matrix.T, rtol=1e-4, atol=1e-4) else None

    def _display(self, output: str) -> Conversion:
        view = self._shot.color.view
        return (
            self._spaces.conversion(output, SRGB)
            if view is None
            else self._spaces.config.view(output, view, "key color.view")
        )
