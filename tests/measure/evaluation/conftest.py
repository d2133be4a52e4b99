"""A tiny shot with truth, lit by the product's own kernels: a sphere, so that what must come out is known."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from yesnt.core.camera import Camera
from yesnt.io.exr import write_exr
from yesnt.relight import EnvMap, GBuffer, RelightSettings, shade

SIDE = 40
FRAMES = (1001, 1002)
RELIGHT = {
    "texels": 128,
    "capture_texels": 64,
    "clusters": 16,
    "capture_clusters": 16,
    "bounce": 0,
    "pixel_filter": 0.0,
}
"""The truth is rendered at pixel centres too."""

LOOK_ALONG_Y = [
    [1, 0, 0, 0],
    [0, 0, 1, -3],
    [0, -1, 0, 0],
    [0, 0, 0, 1],
]  # camera 3 m before the sphere, z forward = +Y


def sphere(camera):
    """Unit sphere at the origin: z [H, W] (0: miss) and world normals [H, W, 3]."""
    rays, eye = camera.rays().astype(float), camera.position()
    a, b, c = (rays**2).sum(-1), 2 * rays @ eye, eye @ eye - 1
    root = b**2 - 4 * a * c
    hit = root > 0
    z = np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / (2 * a), 0)
    return z, (eye + z[..., None] * rays) * hit[..., None], hit.astype(np.float32)


def maps():
    """A warm key from the left, and its mirror in blue."""
    key = np.full((16, 32, 3), 0.15, np.float32)
    key[2:6, 20:26] = (6, 4, 2)
    return {"capture": np.full((16, 32, 3), 1.0, np.float32), "dusk": key[:, ::-1, ::-1].copy(), "noon": key}


def write_shot(folder: Path):
    """Writes the shot and its truth; returns its folder. The material passes it is decomposed from are noisy."""
    rng = np.random.default_rng(11)
    camera = Camera.from_dict({
        "width": SIDE, "height": SIDE, "fx": 48.0, "fy": 48.0, "cx": SIDE / 2, "cy": SIDE / 2,
        "frames": {str(f): {"world_from_camera": LOOK_ALONG_Y} for f in FRAMES},
    })  # fmt: skip
    z, normal, matte = sphere(camera)
    upper = (normal[..., 2] > 0).astype(np.float32)
    base = np.clip(0.35 + 0.3 * np.sin(9 * normal), 0.05, 0.9).astype(np.float32)
    planes = np.stack([0.25 + 0.5 * upper, 0.9 * upper]).astype(np.float32) * matte
    lights = {name: EnvMap.from_array(radiance) for name, radiance in maps().items()}
    (folder / "env").mkdir(parents=True)
    (folder / "truth").mkdir()
    for name, radiance in maps().items():
        write_exr(folder / "env" / f"{name}.exr", rgb(radiance))
    gbuffer = GBuffer(base, *planes, normal.astype(np.float32), z.astype(np.float32), matte)
    settings = RelightSettings(**RELIGHT)
    lit = {name: shade(gbuffer, light, camera, settings).radiance for name, light in lights.items()}
    for frame in FRAMES:
        write_exr(folder / f"plate.{frame}.exr", {**rgb(lit["capture"]), "A": matte})
        axes = {f"N.{axis}": normal[..., i].astype(np.float32) for i, axis in enumerate("XYZ")}
        write_exr(folder / f"gbuffer.{frame}.exr", {"depth.Z": z.astype(np.float32), **axes})
        for name in ("dusk", "noon"):
            write_exr(folder / "truth" / f"relit_{name}.{frame}.exr", {**rgb(lit[name]), "A": matte})
        true = {"roughness.Y": planes[0], "metallic.Y": planes[1]}
        color = {f"base_color.{c}": base[..., i] * matte for i, c in enumerate("RGB")}
        write_exr(folder / "truth" / f"material.{frame}.exr", {**true, **color})
        write_exr(folder / "truth" / f"flow.{frame}.exr", {n: np.zeros_like(matte) for n in ("forward.u", "forward.v")})
        spread = rng.uniform(0.01, 0.15, planes.shape).astype(np.float32)
        noisy = np.clip(planes + spread * rng.normal(size=planes.shape), 0, 1).astype(np.float32)
        write_exr(folder / f"passes.{frame}.exr", {
            "roughness.Y": noisy[0], "metallic.Y": noisy[1],
            "roughness_std.Y": spread[0], "metallic_std.Y": spread[1],
        })  # fmt: skip
    poses = {str(f): {"world_from_camera": LOOK_ALONG_Y} for f in FRAMES}
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    (folder / "camera.json").write_text(json.dumps({**{k: getattr(camera, k) for k in keys}, "frames": poses}))
    document = {
        "version": 1, "name": "ball", "frames": f"{FRAMES[0]}-{FRAMES[-1]}", "plate": {"path": "plate.####.exr"},
        "gbuffer": {"path": "gbuffer.####.exr"}, "camera": "camera.json", "light": {"path": "env/noon.exr"},
        "capture_light": {"path": "env/capture.exr"}, "decompose": {"path": "passes.####.exr"}, "relight": RELIGHT,
    }  # fmt: skip
    (folder / "shot.yaml").write_text(yaml.safe_dump(document))
    return folder


def rgb(picture):
    return {c: np.ascontiguousarray(picture[..., i], dtype=np.float32) for i, c in enumerate("RGB")}


@pytest.fixture
def shot(tmp_path):
    """A fresh copy of the shot."""
    return write_shot(tmp_path / "set" / "ball")


@pytest.fixture(scope="session")
def evaluated(tmp_path_factory):
    """The shot evaluated once in this process: (folder, output, result)."""
    from yesnt.measure.evaluation.run import EvalOptions, run_evaluation

    home = tmp_path_factory.mktemp("eval")
    folder = write_shot(home / "set" / "ball").parent
    return folder, home / "out", run_evaluation(folder, home / "out", EvalOptions(workers=0))
