"""A shot from nothing but videos and a calibration: a painted ball walks past four cameras before a patterned wall."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tests.gaussians.scenes import camera_at
from yesnt.core.camera import Camera
from yesnt.core.distortion import UNDISTORTED, Distortion
from yesnt.io.exr import write_exr

SIDE, RADIUS, LENGTH, FIRST = 80, 0.5, 11, 1001
EYES = ((2.2, 0.4, 0.9), (-0.3, 2.3, 0.7), (-2.2, -0.5, 1.0), (0.4, -2.3, 0.8))


def place(position: int) -> np.ndarray:
    """Where the ball is in a picture of the videos: it comes from one side and leaves to the other."""
    return (position - LENGTH // 2) * np.array([0.35, 0.35, 0.0])


def picture(camera: Camera, centre: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """sRGB values [H, W, 3] of the ball before a wall of one camera's own, and its coverage [H, W]."""
    rays, eye = camera.rays(0).astype(float), camera.position(0) - centre
    way = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(way @ eye)
    discriminant = along**2 - eye @ eye + RADIUS**2
    hit = (discriminant > 0) & (along > 0)
    normal = (eye + (along - np.sqrt(np.maximum(discriminant, 0)))[..., None] * way) / RADIUS
    painted = np.stack(
        [0.75 + 0.15 * np.sin(9 * normal[..., 2]), 0.3 + 0.1 * np.sin(7 * normal[..., 0]), 0 * along], -1
    )
    return np.where(hit[..., None], painted, wall(seed)), hit


def wall(seed: int) -> np.ndarray:
    """Bands of grey and blue, [H, W, 3]."""
    y, x = np.mgrid[:SIDE, :SIDE]
    band = 0.08 * np.sign(np.sin(x / (4 + seed)) * np.sin(y / 5))
    return np.stack([0.35 + band, 0.4 + band, 0.5 + band], axis=-1)


def cameras(bend: float = 0.0) -> dict[str, Camera]:
    """The four cameras, with a first radial coefficient of their lenses."""
    lens = Distortion("brown", (bend, 0.0, 0.0, 0.0)) if bend else UNDISTORTED
    return {f"c{i}": replace(camera_at(eye, (SIDE, SIDE), 55.0), distortion=lens) for i, eye in enumerate(EYES)}


def write_recorded_shot(
    folder: Path, frames: str = "1005-1006", late: dict[str, int] | None = None, bend: float = 0.0, **changes: Any
) -> Path:
    """Writes videos, calibration and `shot.yaml`; the files of `late` cameras are so many pictures late."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = {}
    for number, (name, camera) in enumerate(cameras(bend).items()):
        shift = (late or {}).get(name, 0)
        noise = np.random.default_rng(number)
        shown = (picture(camera, place(i - shift), number)[0] for i in range(LENGTH))
        write_video(folder / "videos" / f"{name}.mkv", [one + 0.01 * noise.normal(size=one.shape) for one in shown])
        entries[name] = lens_of(camera) | {"world_from_camera": camera.pose(0).ravel().tolist()}
        entries[name] |= {"distortion": {"model": "brown", "k": [bend, 0, 0, 0]}} if bend else {}
    (folder / "cameras.json").write_text(json.dumps({"cameras": entries}))
    seen = camera_at((1.4, -1.9, 0.9), (40, 36), 44.0)
    poses = {str(n): {"world_from_camera": seen.pose(0).ravel().tolist()} for n in range(FIRST, FIRST + LENGTH)}
    (folder / "camera.json").write_text(json.dumps(lens_of(seen) | {"frames": poses}))
    sky = np.linspace(0.2, 1.0, 8, dtype=np.float32)[:, None] * np.ones((8, 16), np.float32)
    write_exr(folder / "light.exr", {c: sky for c in "RGB"})
    material = np.full((36, 40), 0.5, np.float32)
    write_exr(folder / "material.exr", {"roughness.Y": material, "metallic.Y": 0 * material})
    knobs = {"steps": 40, "check": 40, "count": 150, "most": 200, "triangles": 600}
    job = {
        "version": 1, "name": "recorded", "frames": frames, "camera": "camera.json", "light": {"path": "light.exr"},
        "capture": {"cameras": "cameras.json", "images": "videos/{camera}.mkv", "first": FIRST, "matting": {}},
        "gaussians": {"every": 2, "held_out": 0, "knobs": knobs}, "evidence": {"use": False},
        "decompose": {"path": "material.exr"}, "quality": "draft", "flow": {"knobs": {"method": "dis-fast"}},
        "relight": {"texels": 8, "capture_texels": 4, "clusters": 8, "capture_clusters": 8},
        "set": {"ground": "auto"}, **changes,
    }  # fmt: skip
    path = folder / "shot.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in job.items() if value is not None}))
    return path


def lens_of(camera: Camera) -> dict[str, Any]:
    return {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}


def write_video(path: Path, pictures: list[np.ndarray], rate: int = 25) -> None:
    """A lossless video of sRGB values [H, W, 3] in [0, 1]."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=rate)
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, "bgr0"
        stream.codec_context.time_base = Fraction(1, rate)
        for position, shown in enumerate(pictures):
            levels = (255 * np.clip(shown, 0, 1) + 0.5).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(levels, format="rgb24").reformat(format="bgr0")
            frame.pts, frame.time_base = position, Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
