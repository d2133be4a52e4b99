"""Smooth normals of a mesh: interpolated between vertices, but for creases."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.proxy import ProxyScene

F32 = NDArray[np.float32]

CREASE = 0.77
"""Cosine, 40 degrees: normals of a mesh are interpolated where its faces meet at a smaller angle."""


def vertex_normals(mesh: ProxyScene) -> F32:
    """Mean of the normals of a vertex's triangles, unit [V, 3]; 0 where they cancel out."""
    corner, normals = mesh.faces.reshape(-1), np.repeat(mesh.normals, 3, axis=0)
    count = len(mesh.vertices)
    total = np.stack([np.bincount(corner, normals[:, k], count) for k in range(3)], axis=-1)
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def smooth_normals(mesh: ProxyScene, face: NDArray[np.int32], weights: tuple[F32, F32, F32]) -> F32:
    """Unit normals [P, 3] at points of triangles [P], by the barycentric weights [P] of the three corners."""
    smooth, corners, flat = vertex_normals(mesh), mesh.faces[face], mesh.normals[face]
    mixed = np.zeros_like(flat, dtype=np.float64)
    for k, weight in enumerate(weights):
        one = smooth[corners[:, k]]
        bent = (one * flat).sum(axis=1, keepdims=True) < CREASE
        mixed += weight[:, None] * np.where(bent, flat, one)
    return (mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)).astype(np.float32)
