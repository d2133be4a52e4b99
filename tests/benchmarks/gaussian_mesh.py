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


def chamfer(vertices: np.ndarray, faces: np.ndarray, truth: np.ndarray, height: float) -> dict[str, float]:
    """Mean distances between a mesh and points of the true surface, both ways, % of the height."""
    import trimesh
    from scipy.spatial import cKDTree

    own = trimesh.sample.sample_surface(trimesh.Trimesh(vertices, faces, process=False), SAMPLES, seed=0)[0]
    there, back = cKDTree(truth).query(own)[0], cKDTree(own).query(truth)[0]
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
    import trimesh

    found = read_cameras(folder / "cameras.json")
    cameras = {name: (one.camera, one.pose_of(frame)) for name, one in found.items()}
    truth = read_mesh(folder / f"truth/mesh.{frame:04d}.ply")
    surface = trimesh.Trimesh(truth.vertices, truth.faces, process=False)
    points = trimesh.sample.sample_surface(surface, SAMPLES, seed=1)[0]
    points = points[seen(points, truth, list(cameras.values()))]
    height = float(np.ptp(truth.vertices, axis=0).max())
    hull = hull_mesh(folder, cameras, frame)
    _keep(keep, "hull", *hull)
    rows = [{"mesh": "visual hull", **chamfer(*hull, points, height)}]
    field = read_field(field_file)
    for knobs in settings:
        began = time.process_time()
        mesh = extract_mesh(field, list(cameras.values()), MeshSettings(**knobs))
        took = time.process_time() - began
        _keep(keep, f"mesh{len(rows)}", mesh.vertices, mesh.faces)
        found_mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        facts = {
            "triangles": len(mesh.faces),
            "closed": bool(found_mesh.is_watertight),
            "processor seconds": round(took, 1),
        }
        rows.append({"mesh": f"level set {knobs or ''}", **chamfer(mesh.vertices, mesh.faces, points, height), **facts})
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
