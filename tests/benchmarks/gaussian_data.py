"""Pictures of a `multiview` set of the capture stage as targets of a fit, and the truth of its held-out cameras."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from yesnt.capture.hull import Silhouette, visual_hull
from yesnt.core.camera import Camera
from yesnt.core.color import srgb_encode, straighten
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.initial import discs, extent, pixel_width
from yesnt.gaussians.rasterise import pinhole_of, rasterise
from yesnt.gaussians.records import View
from yesnt.gaussians.render import rendered_view
from yesnt.gaussians.targets import INSIDE, Target
from yesnt.io.pictures.image import read_image


@dataclass
class Moment:
    """Targets, hull and truth of one frame."""

    targets: list[Target]
    held_out: list[Target]
    truth: list[tuple[np.ndarray, np.ndarray]]  # z and normals of the held-out crops
    silhouettes: list[Silhouette]
    frame: int


def cameras_of(path: Path) -> dict[str, Camera]:
    data = json.loads(path.read_text())
    rest = {key: value for key, value in data.items() if key != "cameras"}
    found = {}
    for name, camera in data["cameras"].items():
        camera = {k: v for k, v in (rest | camera).items() if k != "gain"}
        if "world_from_camera" in camera:
            camera["frames"] = {"0": {"world_from_camera": camera.pop("world_from_camera")}}
        found[name] = Camera.from_dict(camera, str(path))
    return found


def encoded(path: Path):
    """sRGB-encoded associated colour on black, and the matte."""
    rgba = read_image(path).stack("RGBA")
    matte = np.clip(rgba[..., 3], 0, 1).astype(np.float32)
    return (srgb_encode(straighten(rgba[..., :3], rgba[..., 3])) * matte[..., None]).astype(np.float32), matte


def target_of(camera: Camera, path: Path, noise: float = 0.0, seed: int = 0):
    color, matte = encoded(path)
    if noise:
        rng = np.random.default_rng(seed)
        color = np.clip(color + noise * rng.normal(size=color.shape) * matte[..., None], 0, 1).astype(np.float32)
    view = View.of(camera)
    return Target.cropped(view, color, matte), view, matte


def truth_of(path: Path, target: Target, whole: View):
    image = read_image(path)
    top, left = round(whole.cy - target.view.cy), round(whole.cx - target.view.cx)
    part = (slice(top, top + target.view.height), slice(left, left + target.view.width))
    return image.stack(["depth.Z"])[..., 0][part], image.stack(["N.X", "N.Y", "N.Z"])[part]


def load(folder: Path, frame: int = 1001, cameras: int | None = None, noise: float = 0.0) -> Moment:
    rig, held = cameras_of(folder / "cameras.json"), cameras_of(folder / "heldout.json")
    names = sorted(rig)
    if cameras:
        names = [names[i] for i in np.unique(np.linspace(0, len(names) - 1, cameras).round().astype(int))]
    targets, silhouettes, held_out, truth = [], [], [], []
    for i, name in enumerate(names):
        target, _, matte = target_of(rig[name], folder / "capture" / name / f"plate.{frame}.exr", noise, i)
        targets.append(target)
        silhouettes.append(Silhouette(name, rig[name], None, matte))
    for name in sorted(held):
        target, view, _ = target_of(held[name], folder / "heldout" / name / f"plate.{frame}.exr")
        held_out.append(target)
        truth.append(truth_of(folder / "heldout" / name / f"gbuffer.{frame}.exr", target, view))
    return Moment(targets, held_out, truth, silhouettes, frame)


def begin(moment: Moment, settings) -> FitState:
    hull = visual_hull(moment.silhouettes)
    field = discs(hull.points, hull.normals, moment.targets, settings.count, settings.degree, settings.seed)
    return FitState.of(field, extent(hull.points), pixel_width(hull.points, moment.targets))


def measure(state: FitState, moment: Moment) -> dict[str, float]:
    """Figures over the held-out cameras inside the matte: PSNR, normals in degrees, depth in % of the height."""
    errors, angles, depths, holes = [], [], [], []
    field = state.gaussians
    from yesnt.gaussians.rasterise import arrays_of

    for target, (z, normal) in zip(moment.held_out, moment.truth, strict=True):
        raster = rasterise(arrays_of(field), pinhole_of(target.view, field.positions.mean(0), 0.05))
        seen = rendered_view(raster, target.view)
        inside = (target.matte > INSIDE) & (z < 1e9)
        errors.append((np.clip(seen.color, 0, 1) - target.color)[target.matte > INSIDE] ** 2)
        unit = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        angles.append(np.degrees(np.arccos(np.clip((seen.normal * unit).sum(-1)[inside], -1, 1))))
        hit = inside & (seen.surface_z > 0)
        depths.append(100 * (seen.surface_z - z)[hit] / state.height)
        holes.append((seen.surface_z == 0)[inside])
    angles, depths = np.concatenate(angles), np.concatenate(depths)
    return {
        "psnr": float(-10 * np.log10(np.concatenate(errors).mean())),
        "normal": float(np.median(angles)),
        "normal_mean": float(angles.mean()),
        "depth": float(np.median(np.abs(depths))),
        "bias": float(np.median(depths)),
        "holes": float(100 * np.concatenate(holes).mean()),
        "count": state.count,
    }
