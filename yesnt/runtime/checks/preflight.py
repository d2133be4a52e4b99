"""Resolves a job: its settings, frames, backend, and the digest of every input file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from yesnt.capture.files import MATTE, camera_files
from yesnt.capture.person import model_files
from yesnt.capture.plan import CapturePlan, plan_capture
from yesnt.capture.samples import background_files
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.job_progress import Progress, no_progress
from yesnt.core.shot import Job, Shot
from yesnt.decompose.identity import BackendIdentity, identify_backend
from yesnt.decompose.registry import find_weights
from yesnt.io.cameras import calibration_roles, cameras_of
from yesnt.io.fact_cache import FactCache
from yesnt.io.file_digests import FileDigests
from yesnt.io.job_colors import resolve_colors
from yesnt.io.jobfile import frame_path, load_shot, parse_frames, pass_files
from yesnt.io.output import OutputFolder
from yesnt.io.pictures.plate_header import PlateHeader, read_plate_header
from yesnt.io.pictures.shot_raster import for_raster, shot_raster
from yesnt.io.records import digest_of
from yesnt.planning import settings as of
from yesnt.planning.keyed_settings import changed_keys
from yesnt.planning.shot_plan import MATTES, VIEWS, Awaiting
from yesnt.planning.stages import MATTE as MATTE_STAGE
from yesnt.runtime.checks.scene import resolve_scene
from yesnt.temporal.flow import LEARNED

READERS = 2
"""Frames that are decoded side by side while checking; it bounds memory."""


@dataclass(frozen=True)
class Resolved:
    """A job whose files are known.

    Attributes:
        job: the job.
        digests: path -> digest of the file's bytes, for every input.
        backend: what decomposes; None if passes are read.
        notes: what was taken from the files because the job does not say it.
        capture: cameras that measure the materials.
        memory: of the files' digests, to be saved once the output folder may be written to.
        plate_headers: memory of the plates' headers, to be saved with it.
        awaiting: what the run makes first since it is missing or out of date: mattes of the capture, or pictures from
            Gaussian fields. Nothing is known of the stages that read it.
    """

    job: Job
    digests: dict[str, str]
    backend: BackendIdentity | None
    notes: tuple[str, ...]
    capture: CapturePlan
    memory: FileDigests = field(compare=False, repr=False)
    plate_headers: FactCache = field(compare=False, repr=False)
    awaiting: Awaiting = ""

    @property
    def files(self) -> list[str]:
        """Every file that the job's keys depend on: inputs, and the weights of the decomposition."""
        decompose = self.job.shot.decompose
        if self.backend is None:
            return list(self.digests)
        weights = find_weights(decompose.backend, of.weights_path(self.job.root, self.job.shot))
        inside = [path for path in weights.rglob("*") if path.is_file()] if weights.is_dir() else [weights]
        return [*self.digests, *map(str, inside)]


def resolve(
    path: str | Path,
    accept_license: tuple[str, ...] = (),
    progress: Progress = no_progress,
    awaiting: Awaiting = "",
    left_out: Mapping[int, str] = MappingProxyType({}),
) -> Resolved:
    """Reads the job file and hashes every input that has changed since it was hashed last.

    Args:
        path: the job file or its folder.
        accept_license: licences that the user accepts beside those that the job names.
        progress: called while files are hashed.
        awaiting: what the run makes is out of date and is not read.
        left_out: frame -> the stage that could not make what the frame is read from.

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
    camera.check(frames)
    lost = tuple((frame, left_out[frame]) for frame in frames if frame in left_out)
    frames = tuple(frame for frame in frames if frame not in left_out)
    job = Job(shot=shot, root=root, frames=frames, width=camera.width, height=camera.height, left_out=lost)
    _check_knobs(shot)
    backend = None
    if shot.decompose.samples_backend:
        chosen = shot.decompose
        weights = of.weights_path(root, shot)
        backend = identify_backend(chosen.backend, weights, chosen.accept_license, of.backend_knobs(shot))
    memory = FileDigests(OutputFolder.of(job).run / "file_digests.json")
    awaiting = awaiting or _missing(job)
    capture = CapturePlan() if awaiting else plan_capture(job, camera)
    paths = dict.fromkeys((*_input_files(job, awaiting), *capture.files(job)))
    digests = memory.of(paths, lambda done, total: progress("Hashing files", done, total))
    memory.save()
    shot, colors, notes = resolve_colors(shot, root, frames)
    job = job.model_copy(update={"shot": shot, "colors": colors})
    headers = FactCache(OutputFolder.of(job).run / "plate_headers.json")
    if shot.plate.path not in shot.made:  # what is made has the camera's size
        job = _with_raster(job, digests, camera, headers)
        headers.save()
    scenes = FactCache(OutputFolder.of(job).run / "scene_facts.json")
    scene = resolve_scene(job, camera, digests, scenes)
    if scene is not None:
        scenes.save()
        paths = dict.fromkeys(map(Path, scene.files))
        digests |= memory.of(paths, lambda done, total: progress("Hashing files", done, total))
        job = job.model_copy(update={"scene": scene})
    return Resolved(job, digests, backend, notes, capture, memory, headers, awaiting)


def _missing(job: Job) -> Awaiting:
    """What the run makes first, as far as files of it are missing."""
    shot = job.shot
    if (capture := shot.matted) is not None:
        names = cameras_of(job.root, capture)
        frames = job.all_but(MATTE_STAGE.name)
        files = (camera_files(job.root, capture, name, frame)[MATTE] for name in names for frame in frames)
        if not all(path.is_file() for path in files):
            return MATTES
    made = (frame_path(job.root, pattern, frame) for pattern in shot.made for frame in job.frames)
    return "" if all(path.is_file() for path in made) else VIEWS


def _with_raster(job: Job, digests: Mapping[str, str], camera: Camera, headers: FactCache) -> Job:
    """The job with the raster of its plates. A plate that cannot be opened is left to the checks, which say why."""
    spec, plates = job.shot.plate, dict[Path, PlateHeader]()
    settings = digest_of(changed_keys(spec, {"path"}))

    def read(path: Path) -> list[Any]:
        return read_plate_header(path, spec).as_json()

    try:
        for path in dict.fromkeys(frame_path(job.root, spec.path, frame) for frame in job.frames):
            found = headers.fetch(f"{digests[str(path)]} {settings}", partial(read, path))
            plates[path] = PlateHeader.from_json(found)
    except JobError:
        return job
    raster = shot_raster(plates, (camera.width, camera.height))
    if raster is None:
        return job
    width, height = raster.processed.size
    job = job.model_copy(update={"raster": raster, "width": width, "height": height})
    for_raster(camera, job).check(job.frames)
    return job


def _accepting(shot: Shot, licences: tuple[str, ...]) -> Shot:
    decompose = shot.decompose.model_copy(update={"accept_license": (*shot.decompose.accept_license, *licences)})
    return shot.model_copy(update={"decompose": decompose})


def _check_knobs(shot: Shot) -> None:
    checks: tuple[Callable[[Shot], object], ...] = (
        of.ensemble_settings, of.backend_knobs, of.flow_settings, of.energy_params, of.relight_settings,
        of.mesh_settings, of.fit_settings, of.evidence_settings,
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
    if shot.matte:
        yield shot.matte.path
    yield shot.gbuffer.path
    if shot.proxy:
        yield shot.proxy.path
    if shot.gaussians and shot.gaussians.path:
        yield shot.gaussians.path
    yield from pass_files(shot.decompose).values()
    yield from (one.path for one in shot.materials)
    if shot.background:
        yield shot.background.path


def _fitted_pictures(job: Job, mattes: bool) -> Iterable[Path]:
    """Pictures that the run itself fits Gaussian fields to, or makes mattes from; with mattes or without."""
    gaussians, capture = job.shot.gaussians, job.shot.capture
    fits = gaussians is not None and gaussians.path is None
    if capture is not None and (fits or job.shot.matted is not None):
        for name in cameras_of(job.root, capture):
            for frame in job.all_but(MATTE_STAGE.name):
                files = camera_files(job.root, capture, name, frame)
                yield from (path for role, path in files.items() if mattes or role != MATTE)


def _matting_files(job: Job) -> Iterable[Path]:
    """What mattes are made from beside the pictures: clean plates, models that find persons."""
    capture = job.shot.matted
    if capture is not None:
        yield from calibration_roles(job.root, capture).values()
        yield from model_files(job).values()
        for name in cameras_of(job.root, capture):
            yield from background_files(job, name).values()


def _input_files(job: Job, awaiting: Awaiting) -> Iterable[Path]:
    shot = job.shot
    without = shot.made if awaiting else ()
    for pattern in (pattern for pattern in _sequences(shot) if pattern not in without):
        yield from (frame_path(job.root, pattern, frame) for frame in job.frames)
    if shot.gaussians and shot.capture:
        yield from calibration_roles(job.root, shot.capture).values()
    yield from _fitted_pictures(job, mattes=awaiting != MATTES or shot.matted is None)
    yield from _matting_files(job)
    if shot.flow.path:  # the last frame's flow leads out of the shot
        yield from (frame_path(job.root, shot.flow.path, frame) for frame in job.frames[:-1])
    if shot.flow.weights:
        yield frame_path(job.root, shot.flow.weights, 0)
    if shot.set is not None and shot.set.mesh is not None:
        yield frame_path(job.root, shot.set.mesh, 0)
    if shot.scene is not None:
        yield frame_path(job.root, shot.scene, 0)
    yield frame_path(job.root, shot.camera, 0)
    for light in (shot.light, shot.capture_light):
        if light is not None and light.path is not None:
            yield from (frame_path(job.root, light.path, frame) for frame in job.frames)
