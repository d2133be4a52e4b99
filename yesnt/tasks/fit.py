"""Task that fits the Gaussian field of one frame to the pictures of the capture."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.capture.files import camera_files
from yesnt.capture.pictures import read_view
from yesnt.capture.usable import ENOUGH, enough, faults_of, said_of
from yesnt.core.color import srgb_encode
from yesnt.core.color_spaces import INTEROP_OF, PRIMARIES, matrix_to_rec709
from yesnt.core.errors import JobError
from yesnt.core.gaussian_input import FIELD, FOLDER
from yesnt.decompose.evidence.records import View as Seen
from yesnt.gaussians.targets import INSIDE, Target
from yesnt.io.cameras import calibration_roles, cameras_of
from yesnt.io.durable import write_bytes
from yesnt.io.gaussian_ply import write_field
from yesnt.io.jobfile import frame_path
from yesnt.planning import settings as of
from yesnt.planning.task_records import FitTask
from yesnt.tasks.fit_progress import tell_progress
from yesnt.tasks.gaussians import commit_files, fitted_field
from yesnt.tasks.inputs import prove_input
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]

NOT_FINITE = "fit: pixels of the capture that are NaN or infinite and left out of the fit"
UNUSED = "fit: cameras left out of a frame, since their matte is empty, or their picture black or damaged"


@dataclass(frozen=True)
class _Capture:
    """The pictures that are used, the targets of the fit and of its measure, and what is wrong with other pictures."""

    seen: Sequence[Seen]
    targets: Sequence[Target]
    held_out: Sequence[Target]
    damaged: int
    faults: Mapping[str, str]

    @property
    def shown(self) -> Target:
        """The picture that the report compares with the field."""
        return (*self.held_out, *self.targets)[0]


def fit_field(space: Workspace[FitTask]) -> None:
    """Commits the field of a frame.

    At every look at the held-out cameras the state is kept, so that a task that is killed goes on from there, to the
    same bytes: every step follows from the state, the pictures and the settings alone.
    """
    from yesnt.gaussians.fit import fit

    capture, settings = _read_capture(space), of.fit_settings(space.job.shot)
    if space.task.keyframe is not None:
        settings = settings.following()
    looks: list[dict[str, Any]] = []
    with space.kernel():
        state = _kept(space) or _begin(space, capture)
        for look in fit(state, capture.targets, capture.held_out, settings, space.frame):
            psnr = None if np.isnan(look.psnr) else round(look.psnr, 3)
            looks.append({"step": look.step, "of": settings.steps, "gaussians": look.count, "psnr": psnr})
            tell_progress(space.output.run, space.frame, looks, state, capture.shown, settings.near)
            if not look.done:  # a look that ends a fit is taken again rather than passed by
                _keep(space, state.to_arrays())
    path = frame_path(space.output.root, FIELD, space.frame)
    write_field(path, state.gaussians)
    commit_files(space, [path], dict(looks[-1]) | _left_out(capture))
    _checkpoint(space).unlink(missing_ok=True)


def _left_out(capture: _Capture) -> dict[str, Any]:
    """What a record says of pixels and cameras that the fit did without."""
    counts = {NOT_FINITE: capture.damaged, UNUSED: len(capture.faults)}
    clamped = {what: count for what, count in counts.items() if count}
    return ({"clamped": clamped} if clamped else {}) | ({"unused": dict(capture.faults)} if capture.faults else {})


def _read_capture(space: Workspace[FitTask]) -> _Capture:
    """Pictures of the task's cameras, each proved to be the file that the node's key names.

    Raises:
        JobError: too few of them can be used.
    """
    job, frame, known, task = space.job, space.frame, space.node.inputs, space.task
    capture = job.shot.capture
    assert capture is not None
    calibrated, seen = cameras_of(job.root, capture), dict[str, Seen]()
    with space.clock.reading_time():
        for name in (*task.cameras, *task.held_out):
            seen[name] = read_view(job, name, calibrated[name], frame)
            for role, path in camera_files(job.root, capture, name, frame).items():
                prove_input(path, known[f"{role} {name}"])
        for role, path in calibration_roles(job.root, capture).items():
            prove_input(path, known[role])
    faults = faults_of(seen.values())
    fitted, measured = ([seen[name] for name in names if name not in faults] for names in (task.cameras, task.held_out))
    if not enough(len(fitted), len(task.cameras)):
        raise _too_few(frame, len(fitted), len(task.cameras), faults)
    working = job.shot.color.working
    damaged = sum(int(((~np.isfinite(one.radiance).all(-1)) & (one.matte > 0)).sum()) for one in (*fitted, *measured))
    targets = [_target(one, working) for one in fitted]
    held_out = [_target(one, working) for one in measured]
    held_out = [target for target in held_out if (target.matte > INSIDE).any()]  # else there is nothing to measure
    return _Capture(fitted, targets, held_out, damaged, faults)


def _too_few(frame: int, usable: int, cameras: int, faults: Mapping[str, str]) -> JobError:
    return JobError(
        f"Frame {frame} cannot be fitted: the pictures of only {usable} of {cameras} cameras can be used",
        f"capture, frame {frame}: {said_of(faults)}",
        f"pictures and mattes of at least {100 * ENOUGH:.0f} % of the cameras",
        f"mend these pictures or mattes and run again, or `yesnt skip SHOT --frames {frame} --stage fit`",
    )  # fmt: skip


def _target(seen: Seen, working: str) -> Target:
    """A picture as the fit takes it: sRGB code values times coverage; damaged pixels are not covered."""
    from yesnt.gaussians.records import View

    fine = np.asarray(np.isfinite(seen.radiance).all(axis=-1))
    matte = np.where(fine, seen.matte, 0).astype(np.float32)
    radiance = np.where(fine[..., None], seen.radiance, 0) @ matrix_to_rec709(PRIMARIES[INTEROP_OF[working]]).T
    color = srgb_encode(np.maximum(radiance, 0).astype(np.float32)) * matte[..., None]
    return Target.cropped(View.of(seen.camera, seen.pose), color.astype(np.float32), matte)


def _begin(space: Workspace[FitTask], capture: _Capture) -> Any:
    """The state before the first step: discs on the visual hull, or a keyframe's field moved onto it."""
    from yesnt.capture.hull import Silhouette, visual_hull
    from yesnt.gaussians.fit_state import FitState
    from yesnt.gaussians.following import continued
    from yesnt.gaussians.initial import discs, extent, pixel_width

    settings, key = of.fit_settings(space.job.shot), space.task.keyframe
    hull = visual_hull([Silhouette(one.name, one.camera, one.pose, one.matte) for one in capture.seen])
    if hull.empty:
        raise JobError(
            f"The mattes of the capture agree nowhere in frame {space.frame}", f"{len(capture.seen)} cameras",
            "silhouettes of one subject, seen by calibrated cameras in one world",
            "check the mattes, the calibration and the frame numbers of the pictures",
        )  # fmt: skip
    if key is None:
        start = discs(hull.points, hull.normals, capture.targets, settings.count, settings.degree, settings.seed)
    else:
        points, normals = (np.asarray(part, np.float64) for part in (hull.points, hull.normals))
        start = continued(fitted_field(space, key), points, normals, hull.spacing, capture.targets, settings)
    return FitState.of(start, extent(hull.points), pixel_width(hull.points, capture.targets))


def _checkpoint(space: Workspace[FitTask]) -> Path:
    return space.output.root / FOLDER / "checkpoints" / f"{space.frame:04d}.npz"


def _keep(space: Workspace[FitTask], arrays: dict[str, NDArray[Any]]) -> None:
    """Writes the state of a fit, with the node's key: another job's state is never taken up."""
    stream = io.BytesIO()
    np.savez(stream, key=np.array(space.node.key), **arrays)  # type: ignore[arg-type]
    path = _checkpoint(space)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, stream.getvalue())


def _kept(space: Workspace[FitTask]) -> Any:
    """The state that an earlier attempt at this node left; None if there is none."""
    from zipfile import BadZipFile

    from yesnt.gaussians.fit_state import FitState

    try:
        with np.load(_checkpoint(space), allow_pickle=False) as stored:
            if str(stored["key"]) != space.node.key:
                return None
            return FitState.from_arrays({name: stored[name] for name in stored.files if name != "key"})
    except (OSError, ValueError, KeyError, BadZipFile):
        return None
