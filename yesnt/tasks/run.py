"""The only place where kernels meet files: read, kernel, write, commit, small receipt."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.channels import CHANNELS, DELIVERED
from yesnt.core.color import CHROMATICITIES_REC709
from yesnt.core.shot import Job, Shot
from yesnt.core.threads import pin_threads
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import frame_path
from yesnt.io.shot_inputs import file_digest
from yesnt.planning import settings as of
from yesnt.planning.graph import Node
from yesnt.tasks.inputs import read_proven
from yesnt.tasks.light import LightFiles, backdrop, prepared_lights
from yesnt.tasks.workspace import Workspace, release_memory, trim_memory

if TYPE_CHECKING:
    from yesnt.temporal.flow import Matcher

Float32 = NDArray[np.float32]


def run_node(job: Job, node: Node) -> dict[str, Any]:
    """Runs one node on a worker; doing it twice, or after a kill, gives the same files."""
    pin_threads()
    space = Workspace(job, node)
    with space.logged():
        if space.pending():
            _TASKS[node.stage.partition(".")[0]](space)
    return space.receipt()


def window(space: Workspace) -> None:
    """One window of frames of a video backend."""
    from yesnt.tasks.decompose import window as run

    run(space)


def worker_modules(shot: Shot) -> tuple[str, ...]:
    """What a worker imports before its first task; heavy parts that only some jobs need are imported where chosen."""
    always = (
        "yesnt.tasks.run",
        "yesnt.temporal.flow",
        "yesnt.relight.frame",
        "yesnt.tasks.solve",
        "OpenEXR",
        "trimesh",
    )
    return always if shot.decompose.path else (*always, "yesnt.decompose.ensemble", "yesnt.decompose.registry", "torch")


def decompose(space: Workspace) -> None:
    """Mean and spread of the material of one frame."""
    from yesnt.tasks.decompose import decompose as run

    run(space)


def flow(space: Workspace) -> None:
    """Flow of one frame to the next and its validity."""
    from yesnt.temporal import vertical_reach
    from yesnt.temporal.flow import flow_and_validity, flow_validity

    job, frame = space.job, space.node.frames[0]
    after = job.frames[job.position(frame) + 1]
    now, then = space.plate(frame), space.plate(after)
    settings = of.flow_settings(job.shot)
    if job.shot.flow.path is not None:
        vectors = space.inputs.flow()
        with space.kernel():
            inside = now.matte > 0.5, then.matte > 0.5
            validity = flow_validity(vectors, None, now.color, then.color, *inside, settings)
    else:
        with space.kernel():
            match = None if job.shot.flow.weights is None else _matcher(job, space.node.fields["inputs"]["weights"])
            vectors, validity = flow_and_validity(now.color, then.color, now.matte, then.matte, settings, match)
    with space.kernel():
        facts = {"reach": min(vertical_reach(vectors, validity * (now.matte > 0.5)), job.height)}
    space.commit(frame, {"flow": vectors.transpose(2, 0, 1), "validity": validity[None]}, facts=facts)


def trust(space: Workspace) -> None:
    """The data weight of one chunk."""
    from yesnt.tasks.confidence import trust as run

    run(space)


def solve(space: Workspace) -> None:
    """One sweep of the temporal solve: of a block or, jointly, of all frames; or a chunk's frames from its bands."""
    from yesnt.tasks.solve import join_bands, solve_block
    from yesnt.tasks.solve_jointly import solve_jointly

    if "parts" in space.node.arguments:
        join_bands(space)
        return
    release_memory()
    (solve_jointly if "joint" in space.node.arguments else solve_block)(space)
    trim_memory()  # what follows would be stacked on the freed lists


def relight(space: Workspace) -> None:
    """One frame: capture light out, new light in."""
    from yesnt.relight import ProxyScene
    from yesnt.tasks import relight_inputs

    job, frame = space.job, space.node.frames[0]
    camera = space.camera()
    plate, seen = space.plate(frame), space.surface(frame, camera)
    material, mesh = space.read("solve", "material", frame), space.inputs.proxy()
    settings = of.relight_settings(job.shot)
    with space.kernel():
        proxy = relight_inputs.proxy_scene(mesh, ProxyScene)
        inputs = relight_inputs.RelightInputs(plate, seen, camera, frame, proxy)
        lights = prepared_lights(_light_files(space), inputs.surface(material), settings)
        relit = relight_inputs.relight(inputs, material, lights, settings)
    space.commit(
        frame,
        {
            "base_color": relit.base_color.transpose(2, 0, 1),
            "diffuse": relit.diffuse.transpose(2, 0, 1),
            "specular": relit.specular.transpose(2, 0, 1),
            "shadow": relit.shadow[None],
        },
    )


def composite(space: Workspace) -> None:
    """One delivered EXR."""
    from yesnt.scene.composite import associate, over

    job, frame = space.job, space.node.frames[0]
    camera = space.camera()
    plate, surface = space.plate(frame), space.surface(frame, camera)
    diffuse, specular, shadow = (space.read("relight", name, frame) for name in ("diffuse", "specular", "shadow"))
    background = space.inputs.background()
    with space.kernel():
        if background is None:
            background = backdrop(_light_files(space), camera)
        relit = associate((diffuse + specular).transpose(1, 2, 0), plate.matte)
        planes = {
            "composite": over(relit, background).transpose(2, 0, 1),
            "relit": relit.transpose(2, 0, 1),
            "diffuse": diffuse * plate.matte,
            "specular": specular * plate.matte,
            "shadow": shadow,
            "material": space.read("solve", "material", frame),
            "spread": space.read("decompose", "spread", frame),
            "normal": _unit(surface.normal).transpose(2, 0, 1),
            "z": surface.z[None],
        }
        delivered = _exr_planes(planes)
    path = space.output.exr_path(job.shot.name, frame)
    write_exr(path, delivered, _exr_attributes(space), job.shot.exr.compression)
    space.commit(frame, {}, {str(path.relative_to(space.output.root)): file_digest(path)})


def preview(space: Workspace) -> None:
    """A segment of the preview video, or the whole video and the contact sheet from all segments."""
    from yesnt.io.preview import join_segments, write_segment

    output, arguments = space.output, space.node.arguments
    if "segments" in arguments:
        segments, strips = zip(*(output.segment_paths(number) for number in arguments["segments"]), strict=True)
        files = output.run / "preview.mp4", output.run / "contact_sheet.png"
        join_segments(segments, strips, *files)
    else:
        files = output.segment_paths(space.node.index)
        files[0].parent.mkdir(parents=True, exist_ok=True)
        write_segment([output.exr_path(space.job.shot.name, frame) for frame in arguments["frames"]], *files)
    digests = {str(path.relative_to(output.root)): file_digest(path) for path in files}
    space.commit(space.node.frames[0], {}, digests)


def _unit(vectors: Float32) -> Float32:
    """Unit vectors [..., 3]; 0 stays 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return (vectors / np.where(length > 0, length, 1)).astype(np.float32)


def _exr_planes(planes: dict[str, Float32]) -> dict[str, NDArray[np.floating]]:
    """Planes under their EXR names and pixel types, in the registry's order."""
    largest_half = np.float32(65504)
    out: dict[str, NDArray[np.floating]] = {}
    for name in DELIVERED:
        channel = CHANNELS[name]
        for exr_name, plane in zip(channel.exr, planes[name], strict=True):
            # A sun seen in a mirror exceeds half's range; infinity would poison every filter downstream.
            out[exr_name] = (
                plane if channel.exr_pixel == "float" else np.minimum(plane, largest_half).astype(np.float16)
            )
    return out


def _exr_attributes(space: Workspace) -> dict[str, Any]:
    return {
        "chromaticities": CHROMATICITIES_REC709,
        "yesnt:job": space.node.arguments["job_digest"],
        "yesnt:key": space.node.key,
        "yesnt:frame": str(space.node.frames[0]),
    }


def _light_files(space: Workspace) -> LightFiles:
    """The node's maps, known by the digests that its key holds."""
    return LightFiles(space.job, space.node.frames[0], space.node.fields["inputs"])


def _matcher(job: Job, digest: str) -> Matcher:
    """The learned flow that a job names."""
    assert job.shot.flow.weights is not None
    return _spynet(frame_path(job.root, job.shot.flow.weights, 0), digest)


@lru_cache(maxsize=1)
def _spynet(path: Path, digest: str) -> Matcher:
    """The network of these weights; it stays in the worker."""
    from yesnt.decompose.threads import one_thread
    from yesnt.temporal.spynet import open_spynet

    return one_thread()(read_proven(path, digest, lambda: open_spynet(path)).__call__)


_TASKS: dict[str, Callable[[Workspace], None]] = {
    "window": window,
    "decompose": decompose,
    "flow": flow,
    "trust": trust,
    "solve": solve,
    "relight": relight,
    "composite": composite,
    "preview": preview,
}
