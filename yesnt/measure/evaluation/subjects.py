"""Shots with ground truth: their folders, the maps that they were relit under, and the truth as arrays."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import straighten
from yesnt.core.errors import JobError, UsageError
from yesnt.io.jobfile import frame_path, frames_on_disk
from yesnt.io.pictures.image import read_image

F32 = NDArray[np.float32]

TRUTH, RELIT, PROXY, EARLY = "truth", "relit_", "proxy_", "bounces"
"""Folder of the truth, and file prefixes: subject relit in Blender, its proxy mesh, subject with few bounces."""


@dataclass(frozen=True)
class TrueMaterial:
    """Straight truth inside the matte: base colour [H, W, 3] linear, roughness and metallic [2, H, W]."""

    base_color: F32
    planes: F32


@dataclass(frozen=True)
class Subject:
    """One shot folder with `truth/` beside its inputs.

    Attributes:
        folder: of the shot.
        name: label in tables: the folder's path below the set.
        maps: name and file of every map that has truth.
    """

    folder: Path
    name: str
    maps: tuple[tuple[str, Path], ...]

    def env_path(self, name: str) -> Path:
        """The file of a map."""
        return dict(self.maps)[name]

    def relit_path(self, name: str, frame: int, prefix: str = RELIT) -> Path:
        """Blender's picture of a frame under a map."""
        return frame_path(self.folder / TRUTH, f"{prefix}{name}.####.exr", frame)

    def early_paths(self, name: str, frame: int) -> dict[int, Path]:
        """Pictures whose light paths end early, by the number of bounces."""
        found = {}
        for path in sorted((self.folder / TRUTH).glob(f"{EARLY}*_{name}.*.exr")):
            number = path.name[len(EARLY) :].partition("_")[0]
            prefix = f"{EARLY}{number}_"
            if number.isdigit() and path == self.relit_path(name, frame, prefix):
                found[int(number)] = path
        return found

    def material_path(self, frame: int) -> Path:
        """The true material of a frame."""
        return frame_path(self.folder / TRUTH, "material.####.exr", frame)

    def flow_path(self, frame: int) -> Path:
        """The true flow of a frame to the next."""
        return frame_path(self.folder / TRUTH, "flow.####.exr", frame)

    def read_relit(self, name: str, frame: int, prefix: str = RELIT) -> tuple[F32, F32]:
        """Blender's picture as straight linear colour [H, W, 3] and opacity [H, W]."""
        return read_straight(self.relit_path(name, frame, prefix))

    def read_material(self, frame: int, matte: F32) -> TrueMaterial:
        """The true material; renderers multiply it by coverage, which is divided out where the matte is not 0."""
        image = read_image(self.material_path(frame))
        values = image.stack(["roughness.Y", "metallic.Y", "base_color.R", "base_color.G", "base_color.B"])
        straight = np.clip(straighten(values, matte), 0, 1).astype(np.float32)
        return TrueMaterial(
            np.ascontiguousarray(straight[..., 2:]), np.ascontiguousarray(straight[..., :2].transpose(2, 0, 1))
        )

    def read_flow(self, frame: int) -> F32:
        """True flow [H, W, 2] pixels to the next frame."""
        return read_image(self.flow_path(frame)).stack(["forward.u", "forward.v"])

    def has_flow(self, frames: Sequence[int]) -> bool:
        """Whether every pair of these frames has true flow."""
        return len(frames) > 1 and all(self.flow_path(frame).is_file() for frame in frames[:-1])


def read_straight(path: Path) -> tuple[F32, F32]:
    """A picture with associated alpha as straight linear colour [H, W, 3], negative values set to 0, and opacity."""
    picture = read_image(path).stack("RGBA")
    opacity = np.clip(picture[..., 3], 0, 1)
    return straighten(np.maximum(picture[..., :3], 0), opacity), opacity


def find_subjects(
    folder: Path, maps: Sequence[str] | None = None, shots: Sequence[str] | None = None
) -> tuple[Subject, ...]:
    """Every shot with relit truth at or below a folder, by name.

    Args:
        folder: a shot, a set of shots, or a folder of sets.
        maps: the maps to keep; None: all.
        shots: the shots to keep, by name; None: all.

    Raises:
        UsageError: there is no such shot, or no shot has a name or map that was asked for.
    """
    jobs = sorted(folder.rglob("shot.yaml")) if folder.is_dir() else []
    found = [_subject(job.parent, folder) for job in jobs if (job.parent / TRUTH).is_dir()]
    found = [subject for subject in found if subject.maps]
    if not found:
        raise UsageError(
            "There is no shot with truth here", str(folder), "shot.yaml with truth/relit_MAP.####.exr beside it",
            "`yesnt stage` renders them, or name another folder",
        )  # fmt: skip
    if shots is not None:
        _all_known(shots, {subject.name for subject in found}, "There is no shot", "--shots")
        found = [subject for subject in found if subject.name in shots]
    if maps is not None:
        _all_known(maps, {name for subject in found for name, _ in subject.maps}, "No shot has the map", "--maps")
        found = [replace(s, maps=tuple(m for m in s.maps if m[0] in maps)) for s in found]
    return tuple(subject for subject in found if subject.maps)


def _all_known(asked: Sequence[str], known: Set[str], what: str, where: str) -> None:
    unknown = [name for name in asked if name not in known]
    if unknown:
        raise UsageError(f"{what} {unknown[0]!r}", where, ", ".join(sorted(known)), "check its spelling")


def _subject(folder: Path, root: Path) -> Subject:
    names = sorted({p.name[len(RELIT) :].split(".")[0] for p in (folder / TRUTH).glob(f"{RELIT}*.*.exr")})
    name = str(folder.relative_to(root)) if folder != root else folder.absolute().name
    return Subject(folder.absolute(), name, tuple((n, _env(folder.absolute(), n)) for n in names))


def _env(folder: Path, name: str) -> Path:
    """The map of this name beside the shot, or beside its set."""
    for home in (folder, folder.parent):
        path = home / "env" / f"{name}.exr"
        if path.is_file():
            return path
    raise JobError(
        f"The map {name} is missing", str(folder / "env" / f"{name}.exr"), "a lat-long EXR", "render the set again"
    )


def common_frames(subject: Subject, name: str, frames: Sequence[int]) -> tuple[int, ...]:
    """Those frames that have truth under a map."""
    there = frames_on_disk(subject.folder / TRUTH, f"{RELIT}{name}.####.exr")
    return tuple(frame for frame in frames if frame in there)
