"""Says, for `yesnt plan`, which channels of which files serve what, and how the pixels of the shot lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from yesnt.core.camera import Camera
from yesnt.core.shot import Job, PlateInput
from yesnt.io.jobfile import frame_path, pass_patterns
from yesnt.io.pictures.association import association, says_association
from yesnt.io.pictures.channels import Channel
from yesnt.io.pictures.cryptomattes import chosen_name
from yesnt.io.pictures.image import ImageHeader, read_headers
from yesnt.io.pictures.material_pass import quantity_channels
from yesnt.io.pictures.passes import find_color, find_matte, find_normals, find_scalar, find_z, labels

ASPECT_TOLERANCE = 0.01
"""Relative difference between fx * pixel aspect ratio and fy above which `plan` warns."""


def describe_reads(job: Job, frame: int) -> dict[str, str]:
    """Role -> channels of a frame's pictures, from their headers."""
    shot, found = job.shot, {}
    found["plate"] = _color(job, shot.plate, "plate", frame)
    if shot.matte:
        found["matte"] = labels(find_matte(_headers(job, shot.matte.path, frame), shot.matte.channel))
    headers = _headers(job, shot.gbuffer.path, frame)
    z, normals = find_z(headers, shot.gbuffer), find_normals(headers, shot.gbuffer)
    found["z"], found["normals"] = _with_part([z]), _with_part(normals)
    if shot.background:
        found["background"] = _color(job, shot.background, "background", frame)
    if shot.decompose.path and set(pass_patterns(shot.decompose.path)) == {"material"}:
        parts = _headers(job, shot.decompose.path, frame)
        found["materials"] = _with_part([find_scalar(parts, name, "decompose") for name in ("roughness", "metallic")])
    return found | _corrections(job, frame)


def _corrections(job: Job, frame: int) -> dict[str, str]:
    """Channels of passes of one quantity, and of the masks and Cryptomattes of `materials:`."""
    found = {}
    for name, one in job.shot.decompose.quantities.items():
        found[name] = _with_part(quantity_channels(_headers(job, one.path, frame), name, one))
    for number, spec in enumerate(job.shot.materials):
        key, headers = f"materials.{number}", _headers(job, spec.path, frame)
        if spec.mask is not None:
            found[key] = labels(find_matte(headers, spec.channel, key))
        else:
            found[key] = f"{', '.join(spec.names)} of {chosen_name(spec, headers, key)}"
    return found


def describe_raster(job: Job) -> Iterator[str]:
    """Windows, pixel aspect ratio, frame rate and metadata of the plates, where they are not the usual ones."""
    raster = job.raster
    if raster is None:
        return
    if raster.processed != raster.display or raster.display.left or raster.display.top:
        yield f"data window {raster.processed}, display window {raster.display}: all of the data is relit and delivered"
    if raster.aspect != 1:
        yield f"pixel aspect ratio {raster.aspect:g}"
    if raster.rate:
        yield f"{raster.rate[0] / raster.rate[1]:.6g} frames per second"
    if raster.metadata:
        yield f"metadata that is carried on: {', '.join(raster.metadata)}"


def raster_warnings(job: Job, camera: Camera) -> Iterator[str]:
    """What is odd about a camera and the pixels of the plates."""
    raster = job.raster
    if raster is not None and raster.camera.size != raster.display.size:
        yield (
            f"camera: its size {raster.camera.width}x{raster.camera.height} is that of the plates' data windows, not "
            f"of their display window ({raster.display.width}x{raster.display.height}); cx and cy are counted from the "
            "data window's corner"
        )
    aspect = 1.0 if raster is None else raster.aspect
    lens = camera.lens(job.frames[0])
    if abs(lens.fx * aspect - lens.fy) > ASPECT_TOLERANCE * lens.fy:
        yield (
            f"camera: fx {lens.fx:g} times the plates' pixel aspect ratio {aspect:g} is not fy {lens.fy:g}; rays "
            "follow fx and fy, so what is seen is stretched unless the lens is"
        )


def alpha_warnings(job: Job) -> Iterator[str]:
    """Pictures of the first frame whose format does not say how colour and alpha go together, and the job does not."""
    for key, spec in (("plate", job.shot.plate), ("background", job.shot.background)):
        if spec is not None and spec.alpha is None:
            found = find_color(_headers(job, spec.path, job.frames[0]), spec, key)
            header = found.color[0].header
            if found.alpha is not None and not says_association(header):
                yield (
                    f"{key}: {header.format} does not say whether colour is multiplied by alpha; it is read as "
                    f"{association(found, spec)}; set `alpha:` in key {key}"
                )


def _color(job: Job, spec: PlateInput, key: str, frame: int) -> str:
    found = find_color(_headers(job, spec.path, frame), spec, key)
    how = f", {association(found, spec)}" if found.alpha else ", no alpha"
    return f"{_with_part((*found.color, *((found.alpha,) if found.alpha else ())))}{how}, {spec.colorspace}"


def _with_part(channels: Sequence[Channel]) -> str:
    """Channels and, in a file of several parts, the parts that they lie in."""
    parts = dict.fromkeys(c.header.name or str(c.header.part + 1) for c in channels if c.header.parts > 1)
    return labels(channels) + (f" (part {', '.join(parts)})" if parts else "")


def _headers(job: Job, pattern: str, frame: int) -> tuple[ImageHeader, ...]:
    return read_headers(frame_path(job.root, pattern, frame))
