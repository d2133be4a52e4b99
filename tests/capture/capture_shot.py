"""A shot with a capture: the painted sphere of tests/decompose/evidence/scenes.py, seen by calibrated cameras."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from tests.decompose.evidence.scenes import FRAME, around, look_from, picture, smooth_light
from yesnt.io.exr import write_exr

SIZE = 24


@cache
def pictures_of(count):
    """Camera, radiance, matte, normal and z of the plate and of the capture's cameras; costs a second."""
    ways = [np.array([0, -1, 0.05]), *around(count)]
    cameras = [look_from(way, SIZE) for way in ways]
    return [(camera, *picture(camera, smooth_light())) for camera in cameras]


def write_capture_shot(folder: Path, cameras=5, frames=3, **changes):
    """Writes inputs and `shot.yaml`; `changes` replace or add top-level keys, None removes one."""
    numbers, shown = [1001 + i for i in range(frames)], pictures_of(cameras)
    folder.mkdir(parents=True, exist_ok=True)
    _write_plate(folder, numbers, *shown[0])
    for i, (_, color, matte, *_) in enumerate(shown[1:]):
        for number in numbers:
            write_view(folder, f"c{i:02d}", number, color, matte)
    write_cameras(folder, {f"c{i:02d}": view[0] for i, view in enumerate(shown[1:])})
    write_exr(folder / "capture.exr", _rgb(smooth_light().radiance))
    write_exr(folder / "light.exr", _rgb(smooth_light().radiance[::-1]))
    job = {
        "version": 1, "name": "captured", "frames": f"{numbers[0]}-{numbers[-1]}",
        "plate": {"path": "plate.####.exr"}, "gbuffer": {"path": "gbuffer.####.exr"}, "camera": "camera.json",
        "light": {"path": "light.exr"}, "capture_light": {"path": "capture.exr"}, "proxy": {"path": "proxy.ply"},
        "decompose": {"path": "material.exr"}, "flow": {"knobs": {"method": "dis-fast"}},
        "relight": {"texels": 8, "capture_texels": 256, "clusters": 8},
        "capture": {"cameras": "cameras.json", "images": "capture/{camera}/plate.####.exr"}, **changes,
    }  # fmt: skip
    path = folder / "shot.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in job.items() if value is not None}))
    return path


def write_view(folder: Path, camera, number, color, matte):
    """The picture of one camera with associated alpha."""
    target = folder / "capture" / camera / f"plate.{number:04d}.exr"
    target.parent.mkdir(parents=True, exist_ok=True)
    write_exr(target, _rgb(color * matte[..., None]) | {"A": matte.astype(np.float32)})


def write_cameras(folder: Path, cameras, **changes):
    """`cameras.json` of cameras at rest; `changes` replace keys of single cameras."""
    entries = {name: _entry(camera) | changes.get(name, {}) for name, camera in cameras.items()}
    (folder / "cameras.json").write_text(json.dumps({"cameras": entries}))


def truth():
    """Painted roughness and metallic [2, H, W] of the plate, and where the subject is."""
    _, _, matte, _, _, painted = pictures_of(5)[0]
    return np.stack([painted.roughness, painted.metallic]), matte > 0.5


def _entry(camera):
    lens = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    return lens | {"world_from_camera": camera.poses[FRAME].ravel().tolist()}


def _rgb(image):
    return {c: np.ascontiguousarray(image[..., i], np.float32) for i, c in enumerate("RGB")}


def _write_plate(folder, numbers, camera, color, matte, normal, z, _):
    import trimesh

    entry = _entry(camera)
    pose = entry.pop("world_from_camera")
    entry["frames"] = {str(number): {"world_from_camera": pose} for number in numbers}
    (folder / "camera.json").write_text(json.dumps(entry))
    for number in numbers:
        write_exr(folder / f"plate.{number:04d}.exr", _rgb(color) | {"A": matte.astype(np.float32)})
        axes = {f"N.{c}": np.ascontiguousarray(normal[..., i]) for i, c in enumerate("XYZ")}
        write_exr(folder / f"gbuffer.{number:04d}.exr", axes | {"depth.Z": z})
    guess = {"roughness.Y": np.full_like(matte, 0.5), "metallic.Y": np.full_like(matte, 0.3)}
    write_exr(folder / "material.exr", guess)
    trimesh.creation.icosphere(subdivisions=4, radius=1.0).export(folder / "proxy.ply")
