"""Tasks that make mattes: the background of one camera, and the mattes of all cameras in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.files import MATTE as MATTE_FILE
from yesnt.capture.files import VIEW, camera_files
from yesnt.capture.hull import Silhouette
from yesnt.capture.person import Models, model_files
from yesnt.capture.pictures import frame_source, read_recorded
from yesnt.capture.reduced import enlarged_image, reduced_camera, reduced_image
from yesnt.capture.samples import background_files, read_samples
from yesnt.capture.undistort import Resampling, resampling, restoring, undistorted_camera
from yesnt.capture.volume import looked_at
from yesnt.core.camera import Camera
from yesnt.core.errors import CorruptError
from yesnt.core.matting_input import FOLDER
from yesnt.core.shot import Job
from yesnt.io.cameras import CalibratedCamera, calibration_roles, cameras_of
from yesnt.io.durable import write_bytes
from yesnt.io.exr import read_planes, write_exr
from yesnt.io.file_digests import file_digest
from yesnt.io.pictures.png import grey_png_bytes
from yesnt.planning.stages import background_stage
from yesnt.planning.task_records import BackgroundTask, MatteTask
from yesnt.tasks.gaussians import commit_files
from yesnt.tasks.inputs import prove_input
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.capture.matting import Background
    from yesnt.capture.person import View

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

WORK_SIDE = 1280
"""Longest side of the pictures that mattes are found in; larger ones are reduced, and the matte's edges found again."""

NOTHING = "matte: pictures in which no subject was found, by camera:"
"""What a run's summary says of them; the camera's name follows."""

FILLED = "matte: pictures of which the other cameras filled much, since the background may hold the subject, by camera:"
"""What a run's summary says of them; clean plates or `person: true` help."""

MUCH = 0.2
"""Share of a matte from which that is said."""

_BAND = 64  # rows of a background that are found at a time: all samples of a picture at once need much memory


def find_background(space: Workspace[BackgroundTask]) -> None:
    """Commits what a camera shows without the subject, reduced, as EXR."""
    from yesnt.capture.matting import median_background

    job, name = space.job, space.task.camera
    with space.clock.reading_time():
        samples, persons = _samples(space, _cameras(space)[name], _models(space))
        for role, source in background_files(job, name).items():
            prove_input(source, space.node.inputs[role])
    with space.kernel():
        rows = [slice(top, top + _BAND) for top in range(0, samples.shape[1], _BAND)]
        bands = [median_background(samples[:, r], None if persons is None else persons[:, r]) for r in rows]
    planes = {c: np.concatenate([band.color[..., i] for band in bands]) for i, c in enumerate("RGB")}
    known = np.concatenate([band.known for band in bands]).astype(np.float32)
    planes |= {"spread": np.concatenate([band.spread for band in bands]), "known": known}
    path = _background_path(space, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_exr(path, {channel: np.nan_to_num(plane) for channel, plane in planes.items()})
    commit_files(space, [path], {"samples": len(samples), "known": float(known.mean())})


def _samples(
    space: Workspace[BackgroundTask], calibrated: CalibratedCamera, models: Models | None
) -> tuple[F16, F16 | None]:
    """Pictures [N, H, W, 3] of a camera's background, reduced, and the probability [N, H, W] of a person in them."""
    samples, persons = [], []
    for color, whole in read_samples(space.job, space.task.camera, calibrated):
        times, pose = _times(whole), calibrated.pose_of(space.frame)
        small = reduced_image(color, times)
        samples.append(small.astype(np.float16))
        if models is not None:
            camera = reduced_camera(whole, pose, times)
            look = _direction(space.job, space.frame, camera, space.task.camera)
            persons.append(_person(small, look, models).astype(np.float16))
    return np.stack(samples), np.stack(persons) if persons else None


@dataclass(frozen=True)
class _Look:
    """One camera's picture of a frame, reduced: as it was recorded, and where its matte lies without distortion."""

    name: str
    calibrated: CalibratedCamera
    camera: Camera
    levels: U8
    whole: U8
    probability: F32
    matte: F32
    taken: Resampling | None

    def silhouette(self, frame: int) -> Silhouette:
        pose = self.calibrated.pose_of(frame)
        if self.taken is None:
            return Silhouette(self.name, self.camera, pose, self.matte)
        camera = undistorted_camera(self.camera, pose, self.taken)
        return Silhouette(self.name, camera, pose, self.taken.apply(self.matte))


def make_mattes(space: Workspace[MatteTask]) -> None:
    """Commits the mattes of all cameras in a frame, as large as their pictures and distorted like them."""
    capture = space.job.shot.matted
    assert capture is not None
    assert capture.matting is not None
    calibrated = _cameras(space)
    looks = [_look(space, name, calibrated[name]) for name in space.task.cameras]
    with space.kernel():
        mattes = _agreed(space, looks) if capture.matting.consistent else [look.matte for look in looks]
        whole = [_at_full_size(look, matte) for look, matte in zip(looks, mattes, strict=True)]
    paths = []
    for look, matte in zip(looks, whole, strict=True):
        path = camera_files(space.job.root, capture, look.name, space.frame)[MATTE_FILE]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, grey_png_bytes(matte))
        paths.append(path)
    commit_files(space, paths, _facts(looks, mattes))


def _facts(looks: list[_Look], mattes: list[F32]) -> dict[str, Any]:
    """By camera: coverage of the picture, and pixels that the other cameras removed and filled, as its share."""
    pairs = list(zip(looks, mattes, strict=True))
    counted = {f"{NOTHING} {look.name}": 1 for look, matte in pairs if not (matte > 0.5).any()}
    shares: dict[str, Any] = {"coverage": {look.name: round(float(matte.mean()), 6) for look, matte in pairs}}
    for what, sign in (("removed", 1.0), ("filled", -1.0)):
        found = {look.name: np.clip(sign * (look.matte - matte), 0, 1).sum() for look, matte in pairs}
        shares[what] = {look.name: round(float(found[look.name] / max(matte.sum(), 1.0)), 6) for look, matte in pairs}
    counted |= {f"{FILLED} {name}": 1 for name, share in shares["filled"].items() if share > MUCH}
    return shares | ({"clamped": counted} if counted else {})


def _look(space: Workspace[MatteTask], name: str, calibrated: CalibratedCamera) -> _Look:
    from yesnt.capture.matting import display_levels, refined

    job, frame, models = space.job, space.frame, _models(space)
    path, position = frame_source(job, name, frame)
    with space.clock.reading_time():
        color, camera = read_recorded(job, name, calibrated, path, position)
        prove_input(path, space.node.inputs[f"{VIEW} {name}"])
        times, pose = _times(camera), calibrated.pose_of(frame)
        small, camera = reduced_image(color, times), reduced_camera(camera, pose, times)
    with space.kernel():
        probability = _probability(space, small, camera, name, models)
        levels = display_levels(small)
        matte = refined(levels, probability)
        taken = resampling(camera, pose, f"camera {name}")
    whole = levels if times == 1 else display_levels(color)
    return _Look(name, calibrated, camera, levels, whole, probability, matte, taken)


def _probability(space: Workspace[MatteTask], picture: F32, camera: Camera, name: str, models: Models | None) -> F32:
    """Probability [H, W] that a pixel shows the subject: by the background, by persons that are found, or by both."""
    from yesnt.capture.matting import changed, combined

    background = _background(space, name)
    change = None if background is None else changed(picture, background)
    if models is None:
        assert change is not None, "the job file's check"
        return change
    person = _person(picture, _direction(space.job, space.frame, camera, name), models)
    return person if change is None else combined(change, person)


def _agreed(space: Workspace[MatteTask], looks: list[_Look]) -> list[F32]:
    """Mattes of all cameras, each found again with what the hull of the others says."""
    from yesnt.capture.consistent import Support, support_of
    from yesnt.capture.matting import refined

    found = []
    supports = support_of([look.silhouette(space.frame) for look in looks])
    for look, support in zip(looks, supports, strict=True):
        if look.taken is not None:
            back = restoring(look.camera, look.calibrated.pose_of(space.frame), look.taken)
            support = Support(back.apply(support.kept), back.apply(support.log_odds))
        found.append(refined(look.levels, support.applied(look.probability)))
    return found


def _at_full_size(look: _Look, matte: F32) -> F32:
    from yesnt.capture.matting import soft_edges

    height, width = look.whole.shape[:2]
    times = max(1, height // matte.shape[0])
    if times == 1:
        return matte
    return soft_edges(look.whole, enlarged_image(matte, times, (width, height)), times)


def _times(camera: Camera) -> int:
    return -(-max(camera.width, camera.height) // WORK_SIDE)


def _person(picture: F32, look: View, models: Models) -> F32:
    from yesnt.capture.person import person_probability

    return person_probability(picture, look, models)


def _direction(job: Job, frame: int, camera: Camera, name: str) -> View:
    """Which way is up in a camera's picture, and the pixel that all cameras look at."""
    from yesnt.capture.person import View

    capture = job.shot.matted
    assert capture is not None
    cameras = cameras_of(job.root, capture)
    middle, _ = looked_at([(one.camera, one.pose_of(frame)) for one in cameras.values()])
    pose = cameras[name].pose_of(frame)
    up = camera.pose(pose)[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    x, y, z = camera.project(middle[None], pose)[0]
    inside = z > 0 and 0 <= x < camera.width and 0 <= y < camera.height
    centre = (float(x), float(y)) if inside else (0.5 * camera.width, 0.5 * camera.height)
    return View((float(up[0]), float(up[1])), centre)


def _cameras(space: Workspace[Any]) -> dict[str, CalibratedCamera]:
    """The capture's cameras, from files that are those that the node's key names."""
    capture = space.job.shot.matted
    assert capture is not None
    found = cameras_of(space.job.root, capture)
    for role, path in calibration_roles(space.job.root, capture).items():
        prove_input(path, space.node.inputs[role])
    return found


def _models(space: Workspace[Any]) -> Models | None:
    """The models that find persons, proved to be those that the node's key names."""
    files = model_files(space.job)
    for role, path in files.items():
        prove_input(path, space.node.inputs[role])
    return Models(files["detector"], files["body"]) if files else None


def _background_path(space: Workspace[Any], name: str) -> Path:
    return space.output.root / FOLDER / name / "background.exr"


def _background(space: Workspace[MatteTask], name: str) -> Background | None:
    """The background that a camera's task committed; None where the job asks for none.

    Raises:
        CorruptError: its file is not what was committed.
    """
    capture = space.job.shot.matted
    assert capture is not None
    assert capture.matting is not None
    if not capture.matting.has_background:
        return None
    path, number = _background_path(space, name), space.task.cameras.index(name)
    digest = space.committed_file(background_stage(number), space.job.frames[0], path)
    return _read_background(path, digest)


@lru_cache(maxsize=32)
def _read_background(path: Path, digest: str) -> Background:
    from yesnt.capture.matting import Background

    planes = read_planes(path)
    if file_digest(path) != digest:
        raise CorruptError(
            "The background of a camera is not what was committed", str(path), "the file that its record names",
            "`yesnt verify SHOT --repair` makes it again",
        )  # fmt: skip
    color = np.stack([planes[c] for c in "RGB"], axis=-1)
    return Background(color, planes["spread"], planes["known"] > 0.5)
