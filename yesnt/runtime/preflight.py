"""Everything that is checked before any work starts; nothing is written here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, Shot
from yesnt.decompose.identity import BackendIdentity, identify_backend
from yesnt.io import shot_inputs
from yesnt.io.exr import read_header
from yesnt.io.jobfile import frame_path, frames_on_disk, load_shot, parse_frames, pass_patterns
from yesnt.io.mesh import read_mesh
from yesnt.io.output import OutputFolder
from yesnt.planning import settings as of
from yesnt.temporal.flow import LEARNED

READERS = 2
"""Pictures that are decoded side by side while checking; memory is bounded by it."""

STORE_BYTES_PER_PIXEL = 80
"""All arrays of the store and the EXR of one frame, before compression."""


@dataclass(frozen=True)
class Resolved:
    """A job whose files are known.

    Attributes:
        job: the job.
        digests: path -> digest of the file's bytes, for every input.
        backend: what decomposes; None if passes are read.
    """

    job: Job
    digests: dict[str, str]
    backend: BackendIdentity | None


def resolve(path: str | Path, accept_license: tuple[str, ...] = ()) -> Resolved:
    """Reads the job file and hashes every input.

    Args:
        path: the job file or its folder.
        accept_license: licences that the user accepts beside those that the job names.

    Raises:
        JobError: the job file is wrong, or a file is missing.
    """
    file = Path(path).absolute()
    if file.is_dir():
        file = file / "shot.yaml"
    shot = _accepting(load_shot(file), accept_license)
    root = str(file.parent)
    frames = parse_frames(shot.frames, f"{file}, key frames")
    camera = Camera.open(frame_path(root, shot.camera, 0))
    for frame in frames:
        camera.pose(frame)
    job = Job(shot=shot, root=root, frames=frames, width=camera.width, height=camera.height)
    _check_knobs(shot)
    backend = None
    if shot.decompose.path is None:
        chosen = shot.decompose
        weights = of.weights_path(root, shot)
        backend = identify_backend(chosen.backend, weights, chosen.accept_license, of.backend_knobs(shot))
    paths = sorted({str(p) for p in _input_files(job)})
    with ThreadPoolExecutor(READERS) as pool:
        digests = dict(zip(paths, pool.map(lambda p: shot_inputs.file_digest(Path(p)), paths), strict=True))
    return Resolved(job, digests, backend)


def _accepting(shot: Shot, licences: tuple[str, ...]) -> Shot:
    decompose = shot.decompose.model_copy(update={"accept_license": (*shot.decompose.accept_license, *licences)})
    return shot.model_copy(update={"decompose": decompose})


def inspect(resolved: Resolved) -> list[str]:
    """Decodes every input once; returns warnings.

    Raises:
        JobError: a picture, mesh or map cannot be used, or the output folder cannot.
    """
    return inspect_form(resolved) + inspect_content(resolved)


def inspect_form(resolved: Resolved) -> list[str]:
    """What is told in a moment: frames that are too many, sizes, room for the results; returns warnings.

    Raises:
        JobError: as said.
    """
    job = resolved.job
    warnings = list(_check_extra_frames(job))
    for pattern in (job.shot.plate.path, job.shot.gbuffer.path):
        for frame in job.frames:
            shot_inputs.check_size(job, read_header(frame_path(job.root, pattern, frame)))
    output = OutputFolder.of(job)
    output.check(len(job.frames) * job.width * job.height * STORE_BYTES_PER_PIXEL // 2)
    output.refuse_if_running()
    return warnings


def inspect_content(resolved: Resolved) -> list[str]:
    """Decodes every picture, mesh and map; returns warnings.

    Raises:
        JobError: one of them cannot be used.
    """
    job, warnings = resolved.job, []
    camera = Camera.open(frame_path(job.root, job.shot.camera, 0))
    with ThreadPoolExecutor(READERS) as pool:
        counts = Counter[str]()
        for found in pool.map(lambda frame: _check_frame(job, frame, camera), job.frames):
            counts += found
    warnings += [f"{what}: {count} in the shot" for what, count in sorted(counts.items())]
    return warnings + list(_check_maps(job))


def _check_maps(job: Job) -> Iterable[str]:
    """Decodes every map of both lights once."""
    for role, light in (("light", job.shot.light), ("capture_light", job.shot.capture_light)):
        pattern = light.path if light is not None else None
        for path in dict.fromkeys(frame_path(job.root, pattern, frame) for frame in job.frames if pattern is not None):
            _, negative = shot_inputs.read_radiance(path)
            if negative:
                yield f"{role}: {negative} negative values in {path} are read as 0"


def _check_knobs(shot: Shot) -> None:
    checks: tuple[Callable[[Shot], object], ...] = (
        of.ensemble_settings, of.backend_knobs, of.flow_settings, of.energy_params, of.relight_settings,
    )  # fmt: skip
    for check in checks:
        check(shot)
    learned = shot.flow.path is None and of.flow_settings(shot).method in LEARNED
    if learned != (shot.flow.weights is not None):
        raise JobError(
            "A learned flow and its weights belong together", "key flow",
            f"`weights` and `knobs: {{method: {LEARNED[0]}}}`, or neither", "add the other, or remove the one",
        )  # fmt: skip


def _sequences(shot: Shot) -> Iterable[str]:
    yield shot.plate.path
    yield shot.gbuffer.path
    if shot.proxy:
        yield shot.proxy.path
    if shot.decompose.path:
        yield from pass_patterns(shot.decompose.path).values()
    if shot.background:
        yield shot.background.path


def _input_files(job: Job) -> Iterable[Path]:
    shot = job.shot
    for pattern in _sequences(shot):
        yield from (frame_path(job.root, pattern, frame) for frame in job.frames)
    if shot.flow.path:  # the last frame's flow leads out of the shot
        yield from (frame_path(job.root, shot.flow.path, frame) for frame in job.frames[:-1])
    if shot.flow.weights:
        yield frame_path(job.root, shot.flow.weights, 0)
    yield frame_path(job.root, shot.camera, 0)
    for light in (shot.light, shot.capture_light):
        if light is not None and light.path is not None:
            yield from (frame_path(job.root, light.path, frame) for frame in job.frames)


def _check_frame(job: Job, frame: int, camera: Camera) -> Counter[str]:
    """Decodes all of a frame's inputs; counts what is used although it is odd."""
    plate = shot_inputs.read_plate(job, frame)
    surface = shot_inputs.read_surface(job, frame, camera)
    if job.shot.proxy:
        read_mesh(frame_path(job.root, job.shot.proxy.path, frame))
    if job.shot.decompose.path:
        shot_inputs.read_passes(job, frame)
    if job.shot.flow.path and frame != job.frames[-1]:
        shot_inputs.read_flow(job, frame)
    shot_inputs.read_background(job, frame)
    found = Counter[str]()
    found["plate: negative values that are read as 0"] = plate.clamped
    found["gbuffer: pixels inside the matte without depth"] = int(((plate.matte > 0.5) & (surface.z == 0)).sum())
    return +found


def _check_extra_frames(job: Job) -> Iterable[str]:
    """Files of a sequence outside the job's range: most often a range that was typed wrong."""
    for pattern in (job.shot.plate.path, job.shot.gbuffer.path):
        extra = sorted(frames_on_disk(job.root, pattern) - set(job.frames))
        if extra and job.shot.extra_frames == "refuse":
            raise JobError(
                f"{len(extra)} frames on disk are not in the range, first {extra[0]}",
                f"{pattern}; frames: {job.shot.frames}", "a range that covers the sequence",
                "widen `frames:`, or set `extra_frames: ignore`",
            )  # fmt: skip
        if extra:
            yield f"{pattern}: {len(extra)} frames on disk are outside the range and ignored"
