"""Task that composites one frame and writes its EXR."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.channels import CHANNELS, DELIVERED, MEASURED, ON_REQUEST, SET_LAYERS
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.color_config import convert
from yesnt.io.exr import window_attributes, write_exr
from yesnt.io.file_digests import file_digest
from yesnt.planning.stages import EVIDENCE, RELIGHT, SET, SOLVE
from yesnt.planning.task_records import CompositeTask
from yesnt.tasks.light import LightFiles, backdrop
from yesnt.tasks.observations import measured, spread
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.scene.composite import Behind

Float32 = NDArray[np.float32]

LARGEST_HALF = np.float32(65504)

ABOVE_HALF = "composite: values above 65504, the largest of half, clamped to it"


def composite(space: Workspace[CompositeTask]) -> None:
    """Writes the EXR of one frame and commits its digest."""
    from yesnt.scene.composite import associate, into_set, over, over_in_display

    job, frame = space.job, space.frame
    camera = space.camera()
    plate, surface = space.plate(frame, working=True), space.surface(frame, camera)
    diffuse, specular, shadow = (space.read(RELIGHT, name, frame) for name in ("diffuse", "specular", "shadow"))
    behind = _behind(space)
    background = space.inputs.background() if behind is None else behind.picture
    laid = over if job.shot.composite == "linear" else over_in_display
    with space.kernel():
        if background is None:
            background = backdrop(LightFiles.of_task(space), camera)
        relit = associate((diffuse + specular).transpose(1, 2, 0), plate.matte)
        if plate.uncovered is not None:  # a flame covers nothing, and is no surface to relight
            relit[..., :3] += plate.uncovered
        planes = {
            "composite": laid(relit, background) if behind is None else into_set(relit, behind, laid),
            "relit": relit.transpose(2, 0, 1),
            "diffuse": diffuse * plate.matte,
            "specular": specular * plate.matte,
            "shadow": shadow,
            "material": space.read(SOLVE, "material", frame),
            "spread": spread(space, frame),
            "normal": _unit(surface.normal).transpose(2, 0, 1),
            "z": surface.z[None],
        }
        planes["composite"] = planes["composite"].transpose(2, 0, 1)
        planes |= _set_layers(behind)
        planes |= {name: space.read(EVIDENCE, name, frame) for name in MEASURED if measured(space)}
        planes |= {name: space.read(RELIGHT, name, frame) for name in _requested(job) if name == "base_color"}
        planes |= _light_groups(space, planes["composite"], plate.matte)
        delivered, above = _exr_planes({name: _delivered_color(job, name, plane) for name, plane in planes.items()})
    path = space.output.exr_path(job.shot.name, frame)
    write_exr(path, delivered, _exr_attributes(space), job.shot.exr.compression)
    facts = {"clamped": {ABOVE_HALF: above}} if above else {}
    space.commit(frame, {}, {str(path.relative_to(space.output.root)): file_digest(path)}, facts)


def _behind(space: Workspace[CompositeTask]) -> Behind | None:
    """What is behind the subject in a job with a set; None in any other."""
    from yesnt.scene.composite import Behind, opaque

    given = space.job.shot.set
    if given is None:
        return None
    ratio, added = (space.read(SET, name, space.frame).transpose(1, 2, 0) for name in ("set_ratio", "set_added"))
    picture = space.inputs.background()
    if picture is None:
        picture = opaque(space.read(SET, "set_open", space.frame).transpose(1, 2, 0))
    front = space.read(SET, "front", space.frame).transpose(1, 2, 0) if given.blend is not None else None
    return Behind(picture, ratio, added, space.read(SET, "holdout", space.frame)[0], front)


def _light_groups(space: Workspace[CompositeTask], composite: Float32, matte: Float32) -> dict[str, Float32]:
    """The composite [4, H, W] as the sum of what the map's sun gives and the rest; empty if the job wants neither.

    A plate behind the subject and light of the plate itself (flames) are lit by no map: they are in the rest.
    """
    from yesnt.scene.composite import Behind, associate, into_set, opaque, over

    shot, frame = space.job.shot, space.frame
    if not shot.light_groups:
        return {}
    lit = sum(space.read(RELIGHT, name, frame) for name in ("sun_diffuse", "sun_specular"))
    relit = associate(np.asarray(lit).transpose(1, 2, 0), matte)
    if shot.set is not None:
        picture = opaque(space.read(SET, "set_sun", frame).transpose(1, 2, 0))
        whole, nothing = np.ones_like(relit[..., :3]), np.zeros_like(relit[..., :3])
        sun = into_set(relit, Behind(picture, whole, nothing, space.read(SET, "holdout", frame)[0]))
    elif shot.background is not None:
        sun = relit
    else:
        sun = over(relit, backdrop(LightFiles.of_task(space), space.camera(), sun=True))
    by_sun = sun[..., :3].transpose(2, 0, 1)
    groups = {"light_sun": by_sun, "light_rest": composite[:3] - by_sun}
    return {name: groups[name] for name in shot.light_groups}


def _set_layers(behind: Behind | None) -> dict[str, Float32]:
    """The layers of a set; none without one."""
    if behind is None:
        return {}
    front = {} if behind.front is None else {"front": behind.front.transpose(2, 0, 1)}
    return front | {
        "shadow_set": behind.shadow()[None],
        "reflection_set": behind.reflection().transpose(2, 0, 1),
        "env": behind.picture[..., :3].transpose(2, 0, 1),
        "holdout": behind.holdout[None],
    }


def _delivered_color(job: Job, name: str, plane: Float32) -> Float32:
    """A layer [C, H, W] in the output space, if it holds colour; coverage stays as it is.

    The output space is linear, so colour may be associated: coverage multiplies before and after alike.
    """
    if not (CHANNELS[name].colored and job.colors.output.changes):
        return plane
    color = convert(plane[:3].transpose(1, 2, 0), job.colors.output).transpose(2, 0, 1)
    return np.concatenate([color, plane[3:]])


def _requested(job: Job) -> tuple[str, ...]:
    """Layers that the job asks for, in the registry's order."""
    return tuple(name for name in ON_REQUEST if name in job.shot.exr.layers)


def _unit(vectors: Float32) -> Float32:
    """Unit vectors [..., 3]; 0 stays 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return (vectors / np.where(length > 0, length, 1)).astype(np.float32)


def _exr_planes(planes: dict[str, Float32]) -> tuple[dict[str, NDArray[np.floating]], int]:
    """Planes under their EXR names and pixel types, in the registry's order; how many values half cannot hold."""
    out: dict[str, NDArray[np.floating]] = {}
    above = 0
    for name in (name for name in (*DELIVERED, *MEASURED, *SET_LAYERS, *ON_REQUEST) if name in planes):
        channel = CHANNELS[name]
        for exr_name, plane in zip(channel.exr, planes[name], strict=True):
            if channel.exr_pixel == "float":
                out[exr_name] = plane
                continue
            # A sun seen in a mirror exceeds half's range; infinity would poison every filter downstream.
            above += int((np.abs(plane) > LARGEST_HALF).sum())
            out[exr_name] = np.clip(plane, -LARGEST_HALF, LARGEST_HALF).astype(np.float16)
    return out, above


def _raster_attributes(job: Job, frame: int) -> dict[str, Any]:
    """Windows, pixel aspect ratio and metadata as the plate has them; nothing where they are the usual ones."""
    raster = job.raster
    if raster is None:
        return {}
    found: dict[str, Any] = window_attributes(raster.processed, raster.display)
    if raster.aspect != 1:
        found["pixelAspectRatio"] = raster.aspect
    return found | dict(shot_inputs.plate_metadata(job, frame, raster.metadata))


def _exr_attributes(space: Workspace[CompositeTask]) -> dict[str, Any]:
    """The file's header: its colour space, which layers are associated with coverage, and what it was made from."""
    held = space.job.colors.output_space
    associated = [name for name in (*DELIVERED, *_requested(space.job)) if CHANNELS[name].associated]
    return {
        "chromaticities": held.chromaticities,
        **({"colorInteropID": held.interop} if held.interop else {}),
        "yesnt:associated": ", ".join(CHANNELS[name].layer for name in associated),
        **_raster_attributes(space.job, space.frame),
        "yesnt:job": space.task.job_digest,
        "yesnt:key": space.node.key,
        "yesnt:frame": str(space.frame),
    }
