"""Which cameras of the capture measure which frames: decided before a run, from poses and the subject's place alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from yesnt.capture.choose import LEAST_CAMERAS, cameras_that_see, choose_cameras
from yesnt.capture.files import camera_files
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.decompose.settings import keyframe_after
from yesnt.io.cameras import CalibratedCamera, calibration_path, calibration_roles, cameras_of
from yesnt.io.mesh import read_proxy


@dataclass(frozen=True)
class CapturePlan:
    """Cameras that measure the materials.

    Attributes:
        views: frame -> cameras that measure it; empty if nothing is measured. Frames that are not in it take the
            result of the next one along the flow.
        reads: how many cameras are read, for `plan`.
        notes: warnings.
    """

    views: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    reads: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def files(self, job: Job) -> Iterable[Path]:
        """Every file of the capture that the job reads."""
        capture = job.shot.captured
        if capture is None or not self.views:
            return
        yield from calibration_roles(job.root, capture).values()
        for frame, names in self.views.items():
            for name in names:
                yield from camera_files(job.root, capture, name, frame).values()


def plan_capture(job: Job, plate: Camera) -> CapturePlan:
    """Chooses the cameras of every frame that is measured.

    The subject is where the proxy of the first frame is.

    Raises:
        JobError: the cameras cannot be read, lack a pose, or do not see the subject.
    """
    capture, evidence, frames = job.shot.captured, job.shot.evidence, job.frames
    if capture is None:
        return CapturePlan()
    assert job.shot.proxy is not None, "the job file's check"
    file, cameras = calibration_path(job.root, capture), cameras_of(job.root, capture)
    vertices = read_proxy(job, frames[0]).vertices
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    positions = sorted({keyframe_after(p, len(frames), evidence.every) for p in range(len(frames))})
    seeing = {frames[p]: cameras_that_see(cameras, frames[p], vertices, str(file)) for p in positions}
    least = min(len(found) for found in seeing.values())
    if least == 0:
        raise _unseen(next(frame for frame, found in seeing.items() if not found), cameras, file)
    if evidence.use == "auto" and least < LEAST_CAMERAS:
        return CapturePlan(notes=(_too_few(least, len(cameras)),))
    views = {frame: choose_cameras(found, plate, frame, centre, evidence.cameras) for frame, found in seeing.items()}
    most = max(len(names) for names in views.values())
    return CapturePlan(views, reads=(_told(most, len(cameras)),))


def light_probes(views: Mapping[int, tuple[str, ...]]) -> dict[int, tuple[str, ...]]:
    """Frames and cameras that the capture light is estimated from: the first, the middle and the last measured one."""
    frames = sorted(views)
    chosen = sorted({0, (len(frames) - 1) // 2, len(frames) - 1}) if frames else ()
    return {frames[place]: views[frames[place]] for place in chosen}


_ENOUGH = 8  # cameras from which the gain does not grow any more (docs/evidence.md)


def _told(most: int, count: int) -> str:
    """How many cameras measure, and what may be expected of them; their seconds stand among those of the stages."""
    gain = (
        "the error of roughness falls to about a third and that of metallic to half"
        if most >= _ENOUGH
        else f"less gain than with {_ENOUGH}, most of all in roughness"
    )
    return f"capture: {most} of {count} cameras measure the materials of a frame; expected: {gain} (docs/evidence.md)"


def _too_few(least: int, count: int) -> str:
    return (
        f"capture: not used, since {least} of {count} cameras see the subject and {LEAST_CAMERAS} are needed "
        "(`evidence: {use: true}` measures nevertheless)"
    )


def _unseen(frame: int, cameras: Mapping[str, CalibratedCamera], file: Path) -> JobError:
    return JobError(
        f"No camera of the capture sees the subject in frame {frame}", f"{file}: {len(cameras)} cameras",
        "cameras in whose pictures the proxy lies",
        "check `axes` and `units` of the cameras, and that they and the proxy share one world with Z up",
    )  # fmt: skip
