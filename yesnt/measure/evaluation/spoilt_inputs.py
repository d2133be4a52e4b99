"""Writes the inputs of the evidence with errors of a known size, for the ladder of errors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.shot import Shot
from yesnt.io.durable import write_json
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.image import read_image
from yesnt.measure.evaluation.evidence_rows import InputErrors

Float = NDArray[np.floating]

_SEED = 20
_SMOOTH_NORMALS = 1 / 16  # standard deviation of the errors' filter over the picture's height
_SMOOTH_LIGHT = 1 / 12  # over the map's height
_LEAST_LIGHT = 0.3  # of a texel that the error darkens


def spoilt(shot: Shot, errors: InputErrors, frames: tuple[int, ...], folder: Path) -> dict[str, Any]:
    """Sections of a job file that name inputs with errors, which are written to a folder.

    Args:
        shot: of the evaluation, its paths absolute, G-buffer in world space with the stage's channel names.
        errors: their sizes.
        frames: of the shot.
        folder: for the files.
    """
    made: dict[str, Any] = {}
    if errors.normals or errors.depth:
        for frame in frames:
            _gbuffer(frame_path(folder, shot.gbuffer.path, frame), frame_path(folder, _GBUFFER, frame), errors)
        made["gbuffer"] = shot.gbuffer.model_copy(update={"path": str(folder / _GBUFFER)})
    if errors.light and shot.capture_light is not None and shot.capture_light.path is not None:
        light = read_image(Path(shot.capture_light.path)).stack("RGB").astype(np.float64)
        write_exr(folder / "capture.exr", _planes(light * smooth_factor(light.shape[:2], errors.light)))
        made["capture_light"] = shot.capture_light.model_copy(update={"path": str(folder / "capture.exr")})
    if errors.gain and shot.capture is not None:
        write_json(folder / "cameras.json", _gained(json.loads(Path(shot.capture.cameras).read_text()), errors.gain))
        made["capture"] = shot.capture.model_copy(update={"cameras": str(folder / "cameras.json")})
    return made


_GBUFFER = "gbuffer.####.exr"


def _gbuffer(source: Path, target: Path, errors: InputErrors) -> None:
    planes = dict(read_image(source).channels)
    normal = np.stack([planes[f"N.{c}"] for c in "XYZ"], axis=-1).astype(np.float64)
    turned = turned_normals(normal, errors.normals)
    z = planes["depth.Z"]
    planes["depth.Z"] = np.where(z < 1e9, z * (1 + errors.depth), z).astype(np.float32)
    planes |= {f"N.{c}": turned[..., i].astype(np.float32) for i, c in enumerate("XYZ")}
    write_exr(target, planes)


def turned_normals(normal: Float, degrees: float) -> Float:
    """Unit normals [H, W, 3] turned by smooth errors of this root mean square angle; 0 stays 0."""
    known = np.linalg.norm(normal, axis=-1) > 0.5
    if not degrees or not known.any():
        return normal
    error = _smooth((*normal.shape[:2], 3), _SMOOTH_NORMALS * normal.shape[0])
    error -= normal * (normal * error).sum(axis=-1, keepdims=True)
    scale = np.sqrt((error[known] ** 2).sum(axis=-1).mean())
    turned = normal + np.tan(np.radians(degrees)) / scale * error
    turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-12)
    return np.where(known[..., None], turned, 0)


def smooth_factor(shape: tuple[int, int], share: float) -> Float:
    """Factors [h, w, 1] of a map, smooth, about 1 with this standard deviation."""
    field = _smooth((*shape, 1), _SMOOTH_LIGHT * shape[0])
    return np.asarray(np.maximum(1 + share * (field - field.mean()) / field.std(), _LEAST_LIGHT))


def _smooth(shape: tuple[int, ...], sigma: float) -> Float:
    """Smooth noise of mean 0 with the same values in every run."""
    from scipy.ndimage import gaussian_filter

    noise = np.random.Generator(np.random.Philox(_SEED)).standard_normal(shape)
    return np.asarray(gaussian_filter(noise, (sigma, sigma, 0), mode=("nearest", "wrap", "nearest")))


def _gained(document: Mapping[str, Any], share: float) -> dict[str, Any]:
    """A `cameras.json` whose gains are off by this standard deviation."""
    off = np.exp(share * np.random.Generator(np.random.Philox(_SEED)).standard_normal((len(document["cameras"]), 3)))
    cameras = {
        name: camera | {"gain": (np.array(camera.get("gain", [1, 1, 1])) * factor).round(5).tolist()}
        for (name, camera), factor in zip(document["cameras"].items(), off, strict=True)
    }
    return {**document, "cameras": cameras}


def _planes(picture: Float) -> dict[str, NDArray[np.float32]]:
    return {c: np.ascontiguousarray(picture[..., i], dtype=np.float32) for i, c in enumerate("RGB")}
