"""Writes triangle meshes: binary PLY in our world (Z up), and GLB in glTF's (Y up)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.io.durable import write_bytes


def write_ply(path: Path, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
    """Writes a binary PLY, whole or not at all.

    Args:
        path: of the file.
        vertices: [V, 3] world metres.
        faces: [F, 3].
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, faces
    write_bytes(path, header.encode() + np.asarray(vertices, "<f4").tobytes() + rows.tobytes())


def write_glb(path: Path, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
    """Writes a binary glTF with one mesh, whole or not at all; (x, y, z) becomes (x, z, -y), as Blender exports."""
    import trimesh

    turned = np.asarray(vertices, np.float32)[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    mesh = trimesh.Trimesh(turned, np.asarray(faces), process=False)
    write_bytes(path, mesh.export(file_type="glb"))
