"""Tasks that make proxy meshes, plates and G-buffers from Gaussian fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.errors import CorruptError
from yesnt.core.gaussian_input import FIELD, PROXY, VIEW, held_out_of
from yesnt.gaussians.field import GaussianField
from yesnt.io.cameras import calibration_roles, cameras_of
from yesnt.io.exr import write_exr
from yesnt.io.file_digests import file_digest
from yesnt.io.gaussian_ply import read_field
from yesnt.io.jobfile import frame_path
from yesnt.io.mesh_files import write_glb, write_ply
from yesnt.planning import settings as of
from yesnt.planning.stages import FIT
from yesnt.planning.task_records import MeshTask, ViewTask
from yesnt.tasks.inputs import prove_input, read_checked
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]


def extract_proxy(space: Workspace[MeshTask]) -> None:
    """Commits the proxy mesh of a frame as PLY, which later stages read, and GLB."""
    from yesnt.gaussians.mesh import extract_mesh
    from yesnt.gaussians.orbit import cameras_around

    field, settings = _field(space), of.mesh_settings(space.job.shot)
    cameras = _cameras(space) or cameras_around(field)
    with space.kernel():
        mesh = extract_mesh(field, cameras, settings)
    path = frame_path(space.output.root, PROXY, space.frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_ply(path, mesh.vertices, mesh.faces)
    write_glb(path.with_suffix(".glb"), mesh.vertices, mesh.faces)
    commit_files(space, [path, path.with_suffix(".glb")], {"triangles": len(mesh.faces), "gaussians": field.count})


def render_view(space: Workspace[ViewTask]) -> None:
    """Commits the plate and G-buffer of a frame in one EXR."""
    field, camera = _field(space), space.camera()
    with space.kernel():
        planes = view_planes(field, camera, space.frame)
    path = frame_path(space.output.root, VIEW, space.frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_exr(path, planes)
    commit_files(space, [path], {"gaussians": field.count})


def view_planes(field: GaussianField, camera: Camera, frame: int | None) -> dict[str, NDArray[np.floating]]:
    """A field as a camera sees it: R, G, B associated linear Rec.709, A, depth.Z in metres, N.X, N.Y, N.Z in the world.

    Colours that are composited as sRGB code values are made linear where they are straight, as pictures are.
    """
    from yesnt.core.color import srgb_decode, straighten
    from yesnt.gaussians.records import View
    from yesnt.gaussians.render import render
    from yesnt.gaussians.silhouette import turned_at_silhouettes

    seen = render(field, camera, frame)
    color = seen.color
    if field.color_space == "srgb":
        color = srgb_decode(straighten(color, seen.alpha)) * seen.alpha[..., None]
    planes: dict[str, NDArray[np.floating]] = {c: color[..., i].astype(np.float32) for i, c in enumerate("RGB")}
    planes |= {"A": seen.alpha, "depth.Z": seen.surface_z}
    normal = turned_at_silhouettes(seen.normal, seen.alpha, View.of(camera, frame))
    return planes | {f"N.{c}": np.ascontiguousarray(normal[..., i]) for i, c in enumerate("XYZ")}


def _field(space: Workspace[Any]) -> GaussianField:
    gaussians = space.job.shot.gaussians
    assert gaussians is not None
    if gaussians.path is None:
        return fitted_field(space, space.frame)
    path = frame_path(space.job.root, gaussians.path, space.frame)
    with space.clock.reading_time():
        return read_checked(path, space.node.inputs["field"], lambda: read_field(path))


def fitted_field(space: Workspace[Any], frame: int) -> GaussianField:
    """The field that the fit of a frame committed, checked against its record.

    Raises:
        CorruptError: there is no record, or the file is another one.
    """
    path, record = frame_path(space.output.root, FIELD, frame), space.book.find(FIT, frame)
    name = str(path.relative_to(space.output.root))
    with space.clock.reading_time():
        field = read_field(path)
        if record is None or record.files.get(name) != file_digest(path):
            raise CorruptError(
                "A fitted field is not the one that was committed", str(path), "the file of the stage's record",
                "`yesnt verify SHOT --repair` makes it again",
            )  # fmt: skip
    return field


def _cameras(space: Workspace[MeshTask]) -> list[tuple[Camera, int | None]]:
    """The capture's cameras; none if the job has no capture."""
    capture = space.job.shot.capture
    if capture is None:
        return []
    found = cameras_of(space.job.root, capture)
    gaussians = space.job.shot.gaussians
    if gaussians is not None and gaussians.path is None:
        held_out = held_out_of(tuple(found), gaussians.held_out)
        found = {name: one for name, one in found.items() if name not in held_out}
    for role, path in calibration_roles(space.job.root, capture).items():
        prove_input(path, space.node.inputs[role])
    return [(one.camera, one.pose_of(space.frame)) for one in found.values()]


def commit_files(space: Workspace[Any], paths: list[Path], facts: dict[str, Any]) -> None:
    """Commits files below the output folder as a frame's result."""
    files = {str(path.relative_to(space.output.root)): file_digest(path) for path in paths}
    space.commit(space.frame, {}, files, facts)
