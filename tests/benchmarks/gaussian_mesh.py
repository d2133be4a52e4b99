"""The proxy mesh of a fitted field against the true surface and the visual hull.

`python -m tests.benchmarks.gaussian_mesh SUBJECT FIELD.ply [--frame N] [--default] [--keep DIR]` takes a subject of the
stage's multi-view set (docs/stage.md) and its field. Distances are of the subject's height; the truth is what some
camera sees.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from yesnt.core.camera import Camera
from yesnt.gaussians.mesh import extract_mesh
from yesnt.gaussians.mesh_settings import MeshSettings
from yesnt.io.cameras import read_cameras
from yesnt.io.exr import read_planes
from yesnt.io.gaussian_ply import read_field
from yesnt.io.mesh import Mesh, read_mesh
from yesnt.io.mesh_files import write_ply

SAMPLES = 40_000
CANDIDATES = 8  # triangles by whose nearest point a distance is found
Cameras = list[tuple[Camera, int | None]]


def seen(points: np.ndarray, mesh: Mesh, cameras: Cameras) -> np.ndarray:
    """[P] points of a mesh that some camera sees: nothing lies between them and the camera."""
    import trimesh

    scene = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    found = np.zeros(len(points), bool)
    for camera, frame in cameras:
        left = np.flatnonzero(~found)
        x, y, z = camera.project(points[left], frame).T
        left = left[(z > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)]
        ways = camera.position(frame) - points[left]
        length = np.linalg.norm(ways, axis=1, keepdims=True)
        ways /= length
        found[left] = ~scene.ray.intersects_any(points[left] + 1e-3 * ways, ways)
    return found


class Surface:
    """Triangles, or those of them that some camera sees, and points spread evenly over them."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, cameras: Cameras | None = None) -> None:
        import trimesh
        from scipy.spatial import cKDTree

        mesh = trimesh.Trimesh(vertices, faces, process=False)
        self.points, self._face = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
        if cameras is not None:
            shown = seen(self.points, Mesh(vertices, faces), cameras)
            self.points, self._face = self.points[shown], self._face[shown]
        self._corners, self._tree = mesh.triangles, cKDTree(self.points)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """[P] distance of points to the nearest of the triangles that hold the nearest samples."""
        import trimesh

        near = self._face[self._tree.query(points, k=CANDIDATES)[1]]  # [P, CANDIDATES]
        repeated = np.repeat(points, CANDIDATES, axis=0)
        closest = trimesh.triangles.closest_point(self._corners[near.ravel()], repeated)
        return np.linalg.norm(closest - repeated, axis=1).reshape(near.shape).min(axis=1)


def chamfer(vertices: np.ndarray, faces: np.ndarray, truth: Surface, height: float) -> dict[str, float]:
    """Mean distances between points of a mesh and the true surface, both ways, % of the height."""
    own = Surface(vertices, faces)
    there, back = truth.distance(own.points), own.distance(truth.points)
    percent = 100 / height
    return {
        "mesh to truth": round(percent * float(there.mean()), 3),
        "truth to mesh": round(percent * float(back.mean()), 3),
        "chamfer": round(0.5 * percent * float(there.mean() + back.mean()), 3),
        "95th percentile": round(percent * float(max(np.percentile(there, 95), np.percentile(back, 95))), 3),
    }


def hull_mesh(folder: Path, cameras: dict[str, tuple[Camera, int | None]], frame: int) -> tuple[np.ndarray, np.ndarray]:
    """The visual hull of all cameras' mattes."""
    from yesnt.capture.hull import Silhouette, visual_hull

    views = [
        Silhouette(name, camera, pose, read_planes(folder / f"capture/{name}/plate.{frame:04d}.exr")["A"].astype("f4"))
        for name, (camera, pose) in cameras.items()
    ]
    return visual_hull(views).mesh()


def measure(
    folder: Path, field_file: Path, frame: int, settings: list[dict[str, Any]], keep: Path | None = None
) -> list[dict[str, Any]]:
    """Rows of the table: the hull, then the level set by each of the settings."""
    found = read_cameras(folder / "cameras.json")
    cameras = {name: (one.camera, one.pose_of(frame)) for name, one in found.items()}
    truth = read_mesh(folder / f"truth/mesh.{frame:04d}.ply")
    shown = Surface(truth.vertices, truth.faces, list(cameras.values()))
    height = float(np.ptp(truth.vertices, axis=0).max())
    hull = hull_mesh(folder, cameras, frame)
    _keep(keep, "hull", *hull)
    rows = [{"mesh": "visual hull", **chamfer(*hull, shown, height)}]
    field = read_field(field_file)
    for knobs in settings:
        began = time.process_time()
        mesh = extract_mesh(field, list(cameras.values()), MeshSettings(**knobs))
        took = time.process_time() - began
        _keep(keep, f"mesh{len(rows)}", mesh.vertices, mesh.faces)
        edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        shared = np.unique(edges, axis=0, return_counts=True)[1]
        facts = {
            "triangles": len(mesh.faces),
            "open edges": int((shared == 1).sum()),
            "processor seconds": round(took, 1),
        }
        rows.append({"mesh": f"level set {knobs or ''}", **chamfer(mesh.vertices, mesh.faces, shown, height), **facts})
    return rows


def _keep(folder: Path | None, name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        write_ply(folder / f"{name}.ply", np.asarray(vertices, np.float32), np.asarray(faces, np.int32))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("subject", type=Path)
    parser.add_argument("field", type=Path)
    parser.add_argument("--frame", type=int, default=1001)
    parser.add_argument("--default", action="store_true", help="the default settings alone")
    parser.add_argument("--keep", type=Path, help="folder for the hull and the meshes as PLY")
    given = parser.parse_args()
    settings: list[dict[str, Any]] = [{}, {"smoothing": 5}, {"level": 0.7}, {"triangles": 5000}]
    for row in measure(given.subject, given.field, given.frame, settings[: 1 if given.default else None], given.keep):
        print(json.dumps(row))


if __name__ == "__main__":
    main()
