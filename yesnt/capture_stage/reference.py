"""The compositor's reference method: the proxy mesh, coloured by projecting the plate, relit in Cycles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from yesnt.capture_stage.jobs import RenderJob
from yesnt.core.color import straighten
from yesnt.core.errors import JobError
from yesnt.io.exr import write_exr
from yesnt.io.pictures.image import read_image

ROUGHNESS = 0.5
"""Of the proxy: nothing is known, so Blender's own default."""


def projected(job: RenderJob, work: Path, folder: Path) -> dict[str, Any]:
    """The subject of a reference job: mesh, picture to project from the camera, roughness.

    Raises:
        JobError: the shot's plate or proxy is missing: its own set has not been rendered.
    """
    frame = job.frames[0]
    plate, mesh = folder / f"plate.{frame}.exr", folder / f"proxy.{frame}.ply"
    if not plate.exists() or not mesh.exists():
        raise JobError("The reference needs the shot itself", str(plate), "a finished shot", "render its set first")
    rgba = read_image(plate).stack("RGBA")
    color = fill_outwards(straighten(rgba[..., :3], rgba[..., 3]), rgba[..., 3] > 0.5)
    write_exr(work / "projected.exr", {c: np.ascontiguousarray(color[..., i]) for i, c in enumerate("RGB")})
    return {"kind": "projected", "mesh": str(mesh), "image": str(work / "projected.exr"), "roughness": ROUGHNESS}


def fill_outwards(color: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Gives every pixel outside `solid` [H, W] the colour of the nearest one inside; [H, W, 3].

    A decimated mesh reaches beyond the matte here and there, and must not be black there.
    """
    if not solid.any():
        return color
    nearest = distance_transform_edt(~solid, return_distances=False, return_indices=True)
    return color[tuple(nearest)]
