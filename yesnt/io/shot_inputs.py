"""Reads a shot's pictures: straight linear colour, matte, world normals, planar z (method.md section 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.color import straighten
from yesnt.core.color_spaces import Conversion
from yesnt.core.material_input import MATERIAL
from yesnt.core.shot import Job, MatteInput
from yesnt.io.jobfile import frame_path, pass_patterns
from yesnt.io.pictures.association import BEFORE_ENCODING, STRAIGHT, association
from yesnt.io.pictures.channels import channels_of, named
from yesnt.io.pictures.coverage import read_coverage
from yesnt.io.pictures.decode_color import to_scene_linear
from yesnt.io.pictures.image import read_headers
from yesnt.io.pictures.material_pass import read_quantity, single_pass
from yesnt.io.pictures.not_finite import not_finite, refuse_not_finite
from yesnt.io.pictures.passes import (
    Headers,
    find_color,
    find_normals,
    find_scalar,
    find_z,
    labels,
)
from yesnt.io.pictures.placed import read_placed, stored_where
from yesnt.io.pictures.plate_header import carried_attributes
from yesnt.io.pictures.surface import planar_z, world_normals


@dataclass(frozen=True)
class Plate:
    """One captured picture.

    Attributes:
        color: [H, W, 3] straight, linear Rec.709 or in the working space, >= 0; 0 where the matte is 0.
        matte: [H, W] coverage in [0, 1].
        clamped: how many negative values were set to 0.
        alpha_clamped: how many values of the matte were outside [0, 1] and set to its ends.
        has_alpha: whether the coverage was in a file; else every pixel counts as covered.
        uncovered: [H, W, 3] colour that premultiplied pictures have where they cover nothing (flames, reflections), 0
            elsewhere; None: they have none.
        not_finite: how many pixels outside the matte were NaN or infinite and set to 0.
        alpha_peak: largest value of the matte as stored.
    """

    color: NDArray[np.float32]
    matte: NDArray[np.float32]
    clamped: int = 0
    alpha_clamped: int = 0
    has_alpha: bool = True
    uncovered: NDArray[np.float32] | None = None
    not_finite: int = 0
    alpha_peak: float = 1.0

    @property
    def arrays(self) -> tuple[NDArray[np.float32], ...]:
        """All its arrays."""
        return (self.color, self.matte) if self.uncovered is None else (self.color, self.matte, self.uncovered)


@dataclass(frozen=True)
class Surface:
    """What the G-buffer says.

    Attributes:
        normal: [H, W, 3] world, as the renderer averaged it: a short one marks a pixel that straddles an edge.
        z: [H, W] planar metres, 0 on a miss.
    """

    normal: NDArray[np.float32]
    z: NDArray[np.float32]


def read_plate(job: Job, frame: int, working: bool = False) -> Plate:
    """The plate of a frame, in linear Rec.709 or in the working space."""
    return _plate(job, frame, job.colors.plate_working if working else job.colors.plate)


def read_matte(job: Job, frame: int) -> NDArray[np.float32]:
    """The matte of a frame, [H, W] in [0, 1]."""
    return read_plate(job, frame).matte


def read_background(job: Job, frame: int) -> NDArray[np.float32] | None:
    """The background of a frame in the working space as associated RGBA [H, W, 4], or None if the job names none.

    Its own alpha, its colour where that is 0, and its negative values stay as they are.
    """
    if job.shot.background is None:
        return None
    stored = _stored(job, "background", frame)
    refuse_not_finite(not_finite(stored.color), stored.path, stored.label)
    color, uncovered = _straight(stored, job.colors.background)
    rgb = color * stored.matte[..., None]
    return np.concatenate([rgb if uncovered is None else rgb + uncovered, stored.matte[..., None]], axis=-1)


def read_surface(job: Job, frame: int, camera: Camera) -> Surface:
    """The G-buffer of a frame, normals in world space; 0 where it is not finite outside the matte."""
    spec = job.shot.gbuffer
    headers = read_headers(frame_path(job.root, spec.path, frame))
    channels = find_z(headers, spec), *find_normals(headers, spec)
    z, *axes = read_placed(job, channels)
    normal = np.stack(axes, axis=-1)
    _refuse_inside(job, frame, np.isnan(z), headers[0].path, channels[0].label)
    bad = not_finite(normal)
    _refuse_inside(job, frame, bad, headers[0].path, labels(channels[1:]))
    normal = np.where(bad[..., None], 0, normal) if bad.any() else normal
    return Surface(world_normals(normal, spec, camera, frame), planar_z(z, spec, camera, frame))


def read_passes(job: Job, frame: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Roughness and metallic made elsewhere, and their spread where the file has it: two [2, H, W] in [0, 1]."""
    mean, spread = stored_passes(job, frame)
    return np.clip(mean, 0, 1), np.clip(spread, 0, 0.5)


def stored_passes(job: Job, frame: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The same as the files have it, not limited to [0, 1]; 0 where it is not finite outside the matte."""
    if job.shot.decompose.path is None:
        return _quantities(job, frame)
    patterns = pass_patterns(job.shot.decompose.path)
    headers = {name: read_headers(frame_path(job.root, pattern, frame)) for name, pattern in patterns.items()}
    if "material" in headers:
        mean, spread = _material(job, headers["material"])
    else:
        mean = np.stack([single_pass(job, parts, name) for name, parts in headers.items()])
        spread = np.zeros_like(mean)
    for plane, parts in zip(mean, list(headers.values()) * 2, strict=False):
        _refuse_inside(job, frame, ~np.isfinite(plane), parts[0].path, "the material")
    return np.nan_to_num(mean), np.nan_to_num(spread)


def _quantities(job: Job, frame: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Both materials from passes of one quantity each."""
    matte, given = read_matte(job, frame), job.shot.decompose.quantities
    mean = np.stack([read_quantity(job, name, given[name], frame, matte)[0] for name in MATERIAL])
    return mean, np.zeros_like(mean)


def _material(job: Job, headers: Headers) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Both materials of one file and their spread, [2, H, W] each."""
    mean = np.stack(read_placed(job, [find_scalar(headers, name, "decompose") for name in MATERIAL]))
    spreads = [f"{name}_std.Y" for name in MATERIAL]
    channels = {channel.label: channel for channel in channels_of(headers, None, "decompose")}
    known = all(name in channels for name in spreads)
    spread = read_placed(job, [channels[name] for name in spreads]) if known else np.zeros_like(mean)
    return mean, np.stack(list(spread))


def plate_metadata(job: Job, frame: int, names: tuple[str, ...]) -> Mapping[str, Any]:
    """Attributes of a frame's plate that the delivered file carries on, as the OpenEXR package takes them."""
    if not names:
        return {}
    path = frame_path(job.root, job.shot.plate.path, frame)
    part = find_color(read_headers(path), job.shot.plate, "plate").color[0].header.part
    return carried_attributes(path, part, names)


def read_flow(job: Job, frame: int) -> NDArray[np.float32]:
    """Precomputed flow of a frame to the next: [H, W, 2] pixels (dx, dy), x right, y down."""
    pattern = job.shot.flow.path
    assert pattern is not None
    headers = read_headers(frame_path(job.root, pattern, frame))
    channels = channels_of(headers, None, "flow")
    flow = np.stack(read_placed(job, [named(channels, f"forward.{c}", "flow") for c in "uv"]), axis=-1)
    bad = not_finite(flow)
    _refuse_inside(job, frame, bad, headers[0].path, "forward.u, forward.v")
    return np.where(bad[..., None], np.float32(0), flow) if bad.any() else flow


def _plate(job: Job, frame: int, conversion: Conversion) -> Plate:
    stored = _stored(job, "plate", frame)
    bad = not_finite(stored.color)
    if bad.any():
        refuse_not_finite(bad & (stored.matte > 0), stored.path, stored.label)
        stored = replace(stored, color=np.where(bad[..., None], np.float32(0), stored.color))
    color, uncovered = _straight(stored, conversion)
    negative = color < 0
    color = np.where(negative, np.float32(0), color)
    clamps = int(negative.sum()), stored.alpha_clamped, stored.has_alpha
    return Plate(color, stored.matte, *clamps, uncovered, int(bad.sum()), stored.alpha_peak)


@dataclass(frozen=True)
class _Stored:
    """A colour picture as its files hold it: colour [H, W, 3], coverage [H, W] in [0, 1], and the alpha to divide by.

    `by` is None where colour is straight; `own` says that coverage and `by` are the same alpha of the file,
    `decoded_first` that colour was multiplied before it was encoded.
    """

    path: str
    label: str
    color: NDArray[np.float32]
    matte: NDArray[np.float32]
    by: NDArray[np.float32] | None
    own: bool
    decoded_first: bool
    alpha_clamped: int
    has_alpha: bool
    alpha_peak: float


def _stored(job: Job, role: Literal["plate", "background"], frame: int) -> _Stored:
    spec = getattr(job.shot, role)
    matte_input = job.shot.matte if role == "plate" else None
    headers = read_headers(frame_path(job.root, spec.path, frame))
    found = find_color(headers, spec, role)
    planes = read_placed(job, (*found.color, *((found.alpha,) if found.alpha else ())))
    color, alpha = np.stack(planes[:3], axis=-1), planes[3] if found.alpha else None
    coverage = _separate_matte(job, matte_input, frame) if matte_input else alpha
    matte = stored_where(job, found.color[0].header) if coverage is None else coverage
    refuse_not_finite(~np.isfinite(matte), headers[0].path, found.label)
    beyond, peak = (matte < 0) | (matte > 1), float(matte.max(initial=0))
    matte = np.clip(matte, 0, 1).astype(np.float32)
    by = None
    way = association(found, spec)
    if way != STRAIGHT:
        by = matte if alpha is None else np.clip(alpha, 0, 1).astype(np.float32)
    own = by is not None and matte_input is None
    facts = int(beyond.sum()), coverage is not None, peak
    return _Stored(headers[0].path, found.label, color, matte, by, own, way == BEFORE_ENCODING, *facts)


def _straight(stored: _Stored, conversion: Conversion) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Straight converted colour [H, W, 3], 0 where nothing is covered, and the colour there; None if there is none."""
    covered = stored.matte[..., None] > 0
    if stored.by is None:
        straight = to_scene_linear(stored.color, conversion)
    elif stored.decoded_first:
        straight = straighten(to_scene_linear(stored.color, conversion), stored.by)
    else:
        straight = to_scene_linear(straighten(stored.color, stored.by), conversion)
    color = np.where(covered, straight, 0).astype(np.float32)
    if not stored.own or not (stored.color[~covered[..., 0]] != 0).any():
        return color, None
    uncovered = np.where(covered, np.float32(0), stored.color)
    return color, np.where(covered, 0, to_scene_linear(uncovered, conversion)).astype(np.float32)


def _separate_matte(job: Job, spec: MatteInput, frame: int) -> NDArray[np.float32]:
    """Coverage [H, W] from the matte's own file, as stored."""
    return read_coverage(job, read_headers(frame_path(job.root, spec.path, frame)), spec.channel, "matte")[0]


def _refuse_inside(job: Job, frame: int, bad: NDArray[np.bool_], where: str, channels: str) -> None:
    """Refuses values that are not finite inside the matte; what lies outside it is not used."""
    if bad.any():
        refuse_not_finite(bad & (read_matte(job, frame) > 0), where, channels)
