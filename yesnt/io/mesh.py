"""Proxy meshes on disk: triangles in world metres, read with trimesh, refused when too large or not finite."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera_axes import UNITS
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.io.jobfile import frame_path

MAX_MESH_BYTES = 1 << 30
SUFFIXES = (".ply", ".obj", ".stl")


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices [V, 3] float32 metres in the world, faces [F, 3] int32."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def read_proxy(job: Job, frame: int) -> Mesh:
    """The proxy of a frame in metres of the Z-up world, as the job says what its file holds.

    Raises:
        JobError: as `read_mesh`.
    """
    spec = job.shot.proxy
    assert spec is not None, "the caller's check"
    mesh = read_mesh(frame_path(job.root, spec.path, frame))
    if (spec.units, spec.up) == ("m", "z"):
        return mesh
    turned = mesh.vertices[:, [0, 2, 1]] * np.array([1, -1, 1], np.float32) if spec.up == "y" else mesh.vertices
    return Mesh(np.ascontiguousarray(turned * np.float32(UNITS[spec.units])), mesh.faces)


def read_mesh(path: Path, what: str = "The proxy mesh") -> Mesh:
    """Reads a triangle mesh; errors name it as `what`.

    Raises:
        JobError: missing, too large, of another format, empty, or with vertices that are not finite.
    """
    if not path.is_file():
        raise JobError(f"{what} is missing", str(path), "a readable file", "check the path and the frame range")
    if path.suffix.lower() not in SUFFIXES or path.stat().st_size > MAX_MESH_BYTES:
        raise JobError(
            f"{what} cannot be used",
            str(path),
            f"{', '.join(SUFFIXES)} of at most {MAX_MESH_BYTES} bytes",
            "export it again",
        )
    import trimesh

    try:
        mesh = trimesh.load(str(path), force="mesh", process=False)
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    except Exception as error:  # trimesh's readers raise whatever a damaged file provokes
        raise JobError(f"{what} is damaged ({error})", str(path), "a triangle mesh", "export it again") from error
    if not len(faces) or not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise JobError(f"{what} has no usable triangles", str(path), "finite vertices, valid faces", "export it again")
    return Mesh(vertices, faces)
