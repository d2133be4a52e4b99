"""The compositor's reference method: the proxy mesh, coloured by projecting the plate, relit in Cycles.

Plate and mesh are those of the shot, or those of a Gaussian field that an evaluation fitted to the shot's capture.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from yesnt.capture_stage.jobs import RenderJob
from yesnt.core.color import straighten
from yesnt.core.errors import JobError, UsageError
from yesnt.io.exr import write_exr
from yesnt.io.file_digests import file_digest
from yesnt.io.pictures.image import read_image

ROUGHNESS = 0.5
"""Of the proxy: nothing is known, so Blender's own default."""

RECORDS = "stage"
"""Folder below a shot's that holds the records of render jobs."""


def fitted_folder(evaluation: Path, subject: str) -> Path:
    """Folder of the job that fits a field to a subject's capture, below an evaluation's folder."""
    return evaluation / "shots" / subject / "fitted"


def of_fits(jobs: Iterable[RenderJob], evaluation: Path) -> tuple[RenderJob, ...]:
    """The jobs of `reference` whose subjects have a fitted field in an evaluation, each with the digest of its fit.

    Args:
        jobs: of the set `reference`.
        evaluation: folder of `yesnt eval --fit-steps`.

    Raises:
        UsageError: it holds no fitted field of any of them.
    """
    found = []
    for job in jobs:
        digest = _fit_digest(fitted_folder(evaluation, job.subject), job.frames[0])
        found += [replace(job, fit=digest)] if digest else []
    if not found:
        raise UsageError(
            "There is no fitted field here", str(evaluation), "shots/NAME/fitted/out/gaussians/ with view and proxy",
            "run `yesnt eval --fit-steps N` first, or name its folder",
        )  # fmt: skip
    return tuple(found)


def fitted_picture(folder: Path, light: str, frame: int) -> Path | None:
    """Blender's picture of a fitted mesh under a map, if it shows the fit that lies in the folder now; else None.

    Args:
        folder: as `fitted_folder` gives it.
        light: name of the map.
        frame: frame number.
    """
    name, digest = f"truth/proxy_{light}.{frame}.exr", _fit_digest(folder, frame)
    picture = folder / name
    if not digest or not picture.is_file():
        return None
    shown = hashlib.sha256(picture.read_bytes()).hexdigest()
    records = (json.loads(path.read_text()) for path in sorted((folder / RECORDS).glob("*.json")))
    same = any(one["job"].get("fit") == digest and one["files"].get(name) == shown for one in records)
    return picture if same else None


def projected(job: RenderJob, work: Path, folder: Path) -> dict[str, Any]:
    """The subject of a reference job: mesh, picture to project from the camera, roughness.

    Raises:
        JobError: the shot's plate or proxy is missing or has another size, or the fit is no longer that of the job.
    """
    frame = job.frames[0]
    plate, mesh = (
        _fitted_files(folder, frame) if job.fit else (folder / f"plate.{frame}.exr", folder / f"proxy.{frame}.ply")
    )
    if not plate.exists() or not mesh.exists():
        raise JobError("The reference needs the shot itself", str(plate), "a finished shot", "render its set first")
    if job.fit and _fit_digest(folder, frame) != job.fit:
        raise JobError("The field was fitted again meanwhile", str(mesh), "the mesh that the job names", "start again")
    rgba = read_image(plate).stack("RGBA")
    if rgba.shape[:2] != (job.height, job.width):
        size = f"{rgba.shape[1]}x{rgba.shape[0]}"
        raise JobError(
            f"The plate has {size} pixels", str(plate), f"{job.width}x{job.height}", "name the fits of this set"
        )
    color = fill_outwards(straighten(rgba[..., :3], rgba[..., 3]), rgba[..., 3] > 0.5)
    write_exr(work / "projected.exr", {c: np.ascontiguousarray(color[..., i]) for i, c in enumerate("RGB")})
    return {"kind": "projected", "mesh": str(mesh), "image": str(work / "projected.exr"), "roughness": ROUGHNESS}


def _fitted_files(folder: Path, frame: int) -> tuple[Path, Path]:
    """View and mesh of a fitted field."""
    home = folder / "out" / "gaussians"
    return home / f"view.{frame:04d}.exr", home / f"proxy.{frame:04d}.ply"


def _fit_digest(folder: Path, frame: int) -> str:
    """Digest of view and mesh of a fitted field; "" if there is none."""
    files = _fitted_files(folder, frame)
    return "-".join(map(file_digest, files)) if all(path.is_file() for path in files) else ""


def fill_outwards(color: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Gives every pixel outside `solid` [H, W] the colour of the nearest one inside; [H, W, 3].

    A decimated mesh reaches beyond the matte here and there, and must not be black there.
    """
    if not solid.any():
        return color
    nearest = distance_transform_edt(~solid, return_distances=False, return_indices=True)
    return color[tuple(nearest)]
