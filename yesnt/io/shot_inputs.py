"""Reads a shot's pictures: straight linear colour, matte, world normals, planar z (method.md section 1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.color import straighten
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, MatteInput, PlateInput
from yesnt.io.jobfile import frame_path, pass_patterns
from yesnt.io.pictures.association import PREMULTIPLIED, association
from yesnt.io.pictures.channels import channels_of, named
from yesnt.io.pictures.decode_color import to_scene_linear
from yesnt.io.pictures.image import read_channels, read_headers
from yesnt.io.pictures.passes import Headers, find_color, find_matte, find_normals, find_scalar, find_z, labels
from yesnt.io.pictures.placed import read_placed
from yesnt.io.pictures.surface import planar_z, world_normals

MATERIALS = ("roughness", "metallic")


@dataclass(frozen=True)
class Plate:
    """One captured picture.

    Attributes:
        color: [H, W, 3] straight, linear Rec.709, >= 0; 0 where the matte is 0.
        matte: [H, W] coverage in [0, 1].
        clamped: how many negative values were set to 0.
        alpha_clamped: how many values of the matte were outside [0, 1] and set to its ends.
        has_alpha: whether the coverage was in a file; else every pixel counts as covered.
    """

    color: NDArray[np.float32]
    matte: NDArray[np.float32]
    clamped: int = 0
    alpha_clamped: int = 0
    has_alpha: bool = True


@dataclass(frozen=True)
class Surface:
    """What the G-buffer says.

    Attributes:
        normal: [H, W, 3] world, as the renderer averaged it: a short one marks a pixel that straddles an edge.
        z: [H, W] planar metres, 0 on a miss.
    """

    normal: NDArray[np.float32]
    z: NDArray[np.float32]


def read_plate(job: Job, frame: int) -> Plate:
    """The plate of a frame."""
    return _plate(job, job.shot.plate, "plate", frame, job.shot.matte)


def read_matte(job: Job, frame: int) -> NDArray[np.float32]:
    """The matte of a frame, [H, W] in [0, 1]."""
    return read_plate(job, frame).matte


def read_background(job: Job, frame: int) -> NDArray[np.float32] | None:
    """The background of a frame as associated linear colour [H, W, 3], or None if the job names none."""
    if job.shot.background is None:
        return None
    plate = _plate(job, job.shot.background, "background", frame, None)
    return plate.color * plate.matte[..., None]


def read_surface(job: Job, frame: int, camera: Camera) -> Surface:
    """The G-buffer of a frame, normals in world space."""
    spec = job.shot.gbuffer
    headers = read_headers(frame_path(job.root, spec.path, frame))
    channels = find_z(headers, spec), *find_normals(headers, spec)
    z, *axes = read_placed(job, channels)
    normal = np.stack(axes, axis=-1)
    _refuse_nan(np.isnan(z), headers[0].path, channels[0].label)
    _refuse_nan(~np.isfinite(normal), headers[0].path, labels(channels[1:]))
    return Surface(world_normals(normal, spec, camera, frame), planar_z(z, spec, camera))


def read_passes(job: Job, frame: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Roughness and metallic made elsewhere, and their spread where the file has it: two [2, H, W] in [0, 1]."""
    assert job.shot.decompose.path is not None
    patterns = pass_patterns(job.shot.decompose.path)
    headers = {name: read_headers(frame_path(job.root, pattern, frame)) for name, pattern in patterns.items()}
    if "material" in headers:
        mean, spread = _material(job, headers["material"])
    else:
        mean = np.stack([_single(job, parts, name) for name, parts in headers.items()])
        spread = np.zeros_like(mean)
    for plane, parts in zip(mean, list(headers.values()) * 2, strict=False):
        _refuse_nan(~np.isfinite(plane), parts[0].path, "the material")
    return np.clip(mean, 0, 1), np.clip(np.nan_to_num(spread), 0, 0.5)


def _material(job: Job, headers: Headers) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Both materials of one file and their spread, [2, H, W] each."""
    mean = np.stack(read_placed(job, [find_scalar(headers, name, "decompose") for name in MATERIALS]))
    spreads = [f"{name}_std.Y" for name in MATERIALS]
    channels = {channel.label: channel for channel in channels_of(headers, None, "decompose")}
    known = all(name in channels for name in spreads)
    spread = read_placed(job, [channels[name] for name in spreads]) if known else np.zeros_like(mean)
    return mean, np.stack(list(spread))


def _single(job: Job, headers: Headers, name: str) -> NDArray[np.float32]:
    """A pass that has a file of its own, [H, W] raw data; models that paint it in three channels mean their average."""
    alone = {channel.name: channel for channel in channels_of(headers, None, "decompose")}
    for channel in (f"{name}.Y", "Y"):
        if channel in alone:
            return read_placed(job, [alone[channel]])[0]
    if {"R", "G", "B"} <= set(alone):
        return np.stack(read_placed(job, [alone[c] for c in "RGB"])).mean(0).astype(np.float32)
    return read_placed(job, [find_scalar(headers, name, "decompose")])[0]


def read_flow(job: Job, frame: int) -> NDArray[np.float32]:
    """Precomputed flow of a frame to the next: [H, W, 2] pixels (dx, dy), x right, y down."""
    pattern = job.shot.flow.path
    assert pattern is not None
    headers = read_headers(frame_path(job.root, pattern, frame))
    channels = channels_of(headers, None, "flow")
    flow = np.stack(read_placed(job, [named(channels, f"forward.{c}", "flow") for c in "uv"]), axis=-1)
    _refuse_nan(~np.isfinite(flow), headers[0].path, "forward.u, forward.v")
    return flow


def read_radiance(path: Path) -> tuple[NDArray[np.float32], int]:
    """An env map as it lies in its file: [h, w, 3] radiance and how many negative values were set to 0.

    Raises:
        JobError: not an RGB picture, or NaN or Inf in it.
    """
    headers = read_headers(path)
    found = find_color(headers, PlateInput(path=str(path)), "light")
    header = found.color[0].header
    planes = read_channels(header, [channel.name for channel in found.color])
    stored = np.stack([planes[channel.name] for channel in found.color], axis=-1)
    radiance = to_scene_linear(stored, "lin_rec709", header)
    _refuse_nan(~np.isfinite(radiance), str(path), "R, G, B")
    negative = radiance < 0
    return np.where(negative, 0, radiance), int(negative.sum())


def _plate(job: Job, spec: PlateInput, key: str, frame: int, matte_input: MatteInput | None) -> Plate:
    headers = read_headers(frame_path(job.root, spec.path, frame))
    found = find_color(headers, spec, key)
    planes = read_placed(job, (*found.color, *((found.alpha,) if found.alpha else ())))
    color, alpha = np.stack(planes[:3], axis=-1), planes[3] if found.alpha else None
    coverage = _separate_matte(job, matte_input, frame) if matte_input else alpha
    matte = np.ones(color.shape[:2], np.float32) if coverage is None else coverage
    _refuse_nan(~np.isfinite(color).all(-1) | ~np.isfinite(matte), headers[0].path, found.label)
    negative, beyond = color < 0, (matte < 0) | (matte > 1)
    color, matte = np.where(negative, 0, color), np.clip(matte, 0, 1)
    by = matte if alpha is None else np.clip(alpha, 0, 1)
    straight = straighten(color, by) if association(found, spec) == PREMULTIPLIED else color
    straight = to_scene_linear(straight, spec.colorspace, found.color[0].header)
    straight = np.where(matte[..., None] > 0, straight, 0).astype(np.float32)
    return Plate(straight, matte.astype(np.float32), int(negative.sum()), int(beyond.sum()), coverage is not None)


def _separate_matte(job: Job, spec: MatteInput, frame: int) -> NDArray[np.float32]:
    """Coverage [H, W] from the matte's own file, as stored."""
    channels = find_matte(read_headers(frame_path(job.root, spec.path, frame)), spec.channel)
    first, *others = read_placed(job, channels)
    if any(not np.array_equal(first, other) for other in others):
        raise JobError(
            "The matte's red, green and blue differ", channels[0].header.path, "one channel",
            "name it with `channel:` of key matte",
        )  # fmt: skip
    return first


def _refuse_nan(bad: NDArray[np.bool_], where: str, channels: str) -> None:
    count = int(bad.sum())
    if count:
        y, x = (int(v[0]) for v in np.nonzero(bad)[:2])
        raise JobError(
            f"{count} values are NaN or Inf in {channels}",
            f"{where}, first at x={x} y={y}",
            "finite numbers",
            "mend this picture",
        )
