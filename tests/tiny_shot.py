"""A shot made from formulas: a textured sphere that moves to the right before a camera at rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from yesnt.core.camera import Camera
from yesnt.io.exr import write_exr

RADIUS, DISTANCE, STEP = 0.5, 3.0, 0.03


def write_tiny_shot(folder: Path, frames: int = 4, size: tuple[int, int] = (40, 32), **changes: Any) -> Path:
    """Writes inputs and `shot.yaml`; `changes` replace or add top-level keys; returns the job file."""
    folder.mkdir(parents=True, exist_ok=True)
    width, height = size
    numbers = [1001 + i for i in range(frames)]
    # The camera sits at -Y and looks along +Y with +Z up: OpenCV's x, y, z are the world's X, -Z, Y.
    pose = [1, 0, 0, 0, 0, 0, 1, -DISTANCE, 0, -1, 0, 0, 0, 0, 0, 1]
    document = {
        "width": width,
        "height": height,
        "fx": 1.6 * width,
        "fy": 1.6 * width,
        "cx": width / 2,
        "cy": height / 2,
    }
    document["frames"] = {str(n): {"world_from_camera": pose} for n in numbers}
    (folder / "camera.json").write_text(json.dumps(document))
    camera = Camera.from_dict(document)
    for i, number in enumerate(numbers):
        _write_frame(folder, camera, number, i * STEP)
    _write_light(folder)
    job = {
        "version": 1, "name": "tiny", "frames": f"{numbers[0]}-{numbers[-1]}",
        "plate": {"path": "plate.####.exr"}, "gbuffer": {"path": "gbuffer.####.exr"}, "camera": "camera.json",
        "light": {"path": "light.exr"}, "proxy": {"path": "proxy.####.ply"},
        "decompose": {"path": "material.####.exr"}, "flow": {"knobs": {"method": "dis-fast"}},
        "relight": {"texels": 8, "capture_texels": 4, "clusters": 8, "capture_clusters": 8}, **changes,
    }  # fmt: skip
    path = folder / "shot.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in job.items() if value is not None}))
    return path


def _write_frame(folder: Path, camera: Camera, number: int, shift: float) -> None:
    rays, origin = camera.rays(number).astype(np.float64), camera.position(number)
    centre = np.array([shift, 0.0, 0.0])
    z, hit = _intersect(rays, origin - centre)
    normal = np.where(hit[..., None], (origin + z[..., None] * rays - centre) / RADIUS, 0)
    stripes = 0.5 + 0.5 * np.sin(14 * normal[..., 0]) * np.sin(11 * normal[..., 2])
    color = np.where(hit[..., None], np.stack([0.2 + 0.5 * stripes, 0.3 * stripes, 0.2 + 0 * stripes], -1), 0)
    half = np.float16
    planes = {c: color[..., i].astype(half) for i, c in enumerate("RGB")} | {"A": hit.astype(half)}
    write_exr(folder / f"plate.{number:04d}.exr", planes)
    axes = {f"N.{c}": normal[..., i].astype(half) for i, c in enumerate("XYZ")}
    write_exr(folder / f"gbuffer.{number:04d}.exr", axes | {"depth.Z": np.where(hit, z, 1e10).astype(np.float32)})
    rough, metal = 0.3 + 0.4 * stripes, (stripes > 0.8).astype(np.float64)
    write_exr(
        folder / f"material.{number:04d}.exr", {"roughness.Y": rough.astype(half), "metallic.Y": metal.astype(half)}
    )
    _write_sphere(folder / f"proxy.{number:04d}.ply", centre)


def _intersect(rays: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest planar depth at which rays meet the sphere, and where they do."""
    a, b, c = (rays**2).sum(-1), rays @ offset, offset @ offset - RADIUS**2
    root = b * b - a * c
    hit = root > 0
    return np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / a, 0), hit


def _write_sphere(path: Path, centre: np.ndarray) -> None:
    """An octahedron subdivided to a sphere, as ASCII PLY."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=2, radius=RADIUS)
    lines = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices + centre]
    lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
    path.write_text("\n".join(lines) + "\n")


def _write_light(folder: Path) -> None:
    """A dim sky with one bright texel up and to the side."""
    sky = np.full((16, 32, 3), 0.3, np.float32)
    sky[4, 20] = (120, 110, 90)
    write_exr(folder / "light.exr", {c: sky[..., i] for i, c in enumerate("RGB")})
