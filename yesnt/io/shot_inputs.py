"""Reads a shot's pictures: straight linear colour, matte, world normals, planar z (method.md section 1)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.color import straighten
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, PlateInput
from yesnt.io.jobfile import frame_path, pass_patterns
from yesnt.io.pictures.decode_color import to_scene_linear
from yesnt.io.pictures.image import ExrImage, ImageHeader, read_image
from yesnt.io.pictures.surface import planar_z, world_normals


@dataclass(frozen=True)
class Plate:
    """One captured picture.

    Attributes:
        color: [H, W, 3] straight, linear Rec.709, >= 0; 0 where the matte is 0.
        matte: [H, W] coverage in [0, 1].
        clamped: how many negative values were set to 0.
    """

    color: NDArray[np.float32]
    matte: NDArray[np.float32]
    clamped: int = 0


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
    return _plate(job, job.shot.plate, frame)


def read_matte(job: Job, frame: int) -> NDArray[np.float32]:
    """The matte of a frame, [H, W] in [0, 1]."""
    return read_plate(job, frame).matte


def read_background(job: Job, frame: int) -> NDArray[np.float32] | None:
    """The background of a frame as associated linear colour [H, W, 3], or None if the job names none."""
    if job.shot.background is None:
        return None
    plate = _plate(job, job.shot.background, frame)
    return plate.color * plate.matte[..., None]


def read_surface(job: Job, frame: int, camera: Camera) -> Surface:
    """The G-buffer of a frame, normals in world space."""
    spec = job.shot.gbuffer
    image = read_image(frame_path(job.root, spec.path, frame))
    check_size(job, image.header)
    z = image.stack([spec.z])[..., 0]
    normal = image.stack([f"{spec.normal}.{axis}" for axis in "XYZ"])
    _refuse_nan(np.isnan(z), image.header.path, spec.z)
    _refuse_nan(~np.isfinite(normal), image.header.path, spec.normal)
    return Surface(world_normals(normal, spec, camera, frame), planar_z(z, spec, camera))


def read_passes(job: Job, frame: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Roughness and metallic made elsewhere, and their spread where the file has it: two [2, H, W] in [0, 1]."""
    assert job.shot.decompose.path is not None
    patterns = pass_patterns(job.shot.decompose.path)
    images = {name: read_image(frame_path(job.root, pattern, frame)) for name, pattern in patterns.items()}
    for image in images.values():
        check_size(job, image.header)
    if "material" in images:
        image = images["material"]
        mean = image.stack(["roughness.Y", "metallic.Y"]).transpose(2, 0, 1)
        names = ("roughness_std.Y", "metallic_std.Y")
        known = all(name in image.channels for name in names)
        spread = image.stack(names).transpose(2, 0, 1) if known else np.zeros_like(mean)
    else:
        mean = np.stack([_single(image, name) for name, image in images.items()])
        spread = np.zeros_like(mean)
    for plane, image in zip(mean, list(images.values()) * 2, strict=False):
        _refuse_nan(~np.isfinite(plane), image.header.path, "the material")
    return np.clip(mean, 0, 1), np.clip(np.nan_to_num(spread), 0, 0.5)


def _single(image: ExrImage, name: str) -> NDArray[np.float32]:
    """A pass that has a file of its own, [H, W] raw data; models that paint it in three channels mean their average."""
    for channel in (f"{name}.Y", "Y"):
        if channel in image.channels:
            return image.stack([channel])[..., 0]
    return image.stack("RGB").mean(-1).astype(np.float32)


def read_flow(job: Job, frame: int) -> NDArray[np.float32]:
    """Precomputed flow of a frame to the next: [H, W, 2] pixels (dx, dy), x right, y down."""
    pattern = job.shot.flow.path
    assert pattern is not None
    image = read_image(frame_path(job.root, pattern, frame))
    check_size(job, image.header)
    flow = image.stack(["forward.u", "forward.v"])
    _refuse_nan(~np.isfinite(flow), image.header.path, "forward.u, forward.v")
    return flow


def read_radiance(path: Path) -> tuple[NDArray[np.float32], int]:
    """An env map as it lies in its file: [h, w, 3] radiance and how many negative values were set to 0.

    Raises:
        JobError: not an RGB picture, or NaN or Inf in it.
    """
    image = read_image(path)
    if not all(c in image.channels for c in "RGB"):
        raise JobError("The env map has no R, G, B", str(path), "a lat-long EXR or HDR", "export it again")
    radiance = to_scene_linear(image.stack("RGB"), "lin_rec709", image.header)
    _refuse_nan(~np.isfinite(radiance), str(path), "R, G, B")
    negative = radiance < 0
    return np.where(negative, 0, radiance), int(negative.sum())


def check_size(job: Job, header: ImageHeader) -> None:
    """Refuses a picture of another size than the camera's.

    Raises:
        JobError: the sizes differ.
    """
    if (header.width, header.height) != (job.width, job.height):
        raise JobError(
            f"The picture is {header.width}x{header.height}",
            header.path,
            f"{job.width}x{job.height}, as camera.json says",
            "render every input at one size",
        )


def _plate(job: Job, spec: PlateInput, frame: int) -> Plate:
    image = read_image(frame_path(job.root, spec.path, frame))
    check_size(job, image.header)
    color = image.stack("RGB")
    matte = image.channels.get("A", np.ones(color.shape[:2], np.float32))
    _refuse_nan(~np.isfinite(color).all(-1) | ~np.isfinite(matte), image.header.path, "R, G, B, A")
    negative = color < 0
    color = np.where(negative, 0, color)
    matte = np.clip(matte, 0, 1)
    # A display-referred picture is encoded before its alpha is associated; scene-linear EXRs are associated.
    straight = color if spec.colorspace == "srgb" else straighten(color, matte)
    straight = to_scene_linear(straight, spec.colorspace, image.header)
    straight = np.where(matte[..., None] > 0, straight, 0).astype(np.float32)
    return Plate(straight, matte.astype(np.float32), int(negative.sum()))


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
