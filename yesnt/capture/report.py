"""What a capture is like, before anything is fitted: calibration, overlap, mattes, time and gain (docs/capture.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from yesnt.capture.agreement import estimate_gains, estimate_offsets, find_mistakes
from yesnt.capture.hull import Hull, Silhouette, required_views, visual_hull
from yesnt.capture.pictures import read_silhouette, read_view
from yesnt.capture.reduced import reduced_camera, reduced_image
from yesnt.capture.usable import enough, faults_of
from yesnt.capture.volume import Posed, common_volume, has_in_picture, looked_at
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.decompose.evidence.records import View
from yesnt.gaussians.targets import MARGIN
from yesnt.io.cameras import CalibratedCamera, calibration_path, cameras_of

FARTHEST, NEAREST = 100.0, 0.05
"""Metres from the place that all cameras look at to the farthest one, beyond which the unit is wrong."""

_LARGEST, _SMALLEST = 20.0, 0.05  # metres of the subject's longest side
_GAIN = 0.25  # by which a camera's gain differs before it is a problem: gloss alone makes tenths
_SIDE = 400  # rows or columns of mattes that are compared; larger pictures are read at full size and reduced


@dataclass(frozen=True)
class CaptureReport:
    """Findings of a capture.

    Attributes:
        problems: paragraphs on what is wrong; empty if nothing is.
        offsets: camera -> frames by which it is late beside what the job says; empty where time was not looked at.
        gains: camera -> factors of red, green, blue that bring it to the mean of all.
        subject: size of the subject's box, metres, [3]; None where the mattes agree nowhere.
        cameras: their number.
        sizes: camera -> pixels of its picture, and of the part around its matte; empty where no picture was read.
    """

    problems: tuple[str, ...]
    offsets: Mapping[str, int]
    gains: Mapping[str, tuple[float, ...]]
    subject: tuple[float, ...] | None
    cameras: int
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)


def report_capture(job: Job, frame: int, reach: int = 0) -> CaptureReport:
    """Looks at a capture in one frame, and at its time in the frames around it.

    Args:
        job: a job with `capture`.
        frame: frame that is looked at.
        reach: largest offset in time that is tried, frames; 0: time is not looked at.

    Raises:
        JobError: the job has no capture, or a file cannot be read.
    """
    capture = job.shot.capture
    if capture is None:
        raise JobError("The job has no capture", "key capture", "cameras and their pictures", "add the section")
    cameras = cameras_of(job.root, capture)
    problems = list(pose_problems(cameras, frame))
    if problems:  # pictures say nothing before these are mended
        return CaptureReport(tuple(problems), {}, {}, None, len(cameras))
    views = _read(job, cameras, frame)
    faults = faults_of(views)
    problems += [_of_fault(name, fault) for name, fault in faults.items()]
    sizes = {view.name: (view.matte.size, _crop_pixels(view.matte)) for view in views}
    views = [view for view in views if view.name not in faults]
    if not enough(len(views), len(cameras)):
        return CaptureReport(tuple(problems), {}, {}, None, len(cameras), sizes)
    silhouettes = [_reduced(view) for view in views]
    problems += [finding.text for finding in find_mistakes(silhouettes)]
    hull = visual_hull(silhouettes)
    problems += _of_size(hull, str(calibration_path(job.root, capture)))
    offsets: dict[str, int] = {}
    if reach and not hull.empty:
        offsets = estimate_offsets(_moments(job, cameras, frame, reach), reach)
        problems += _of_time(offsets, reach)
    gains = {} if hull.empty else estimate_gains(hull.points, hull.normals, _pairs(views))
    problems += _of_gains(gains)
    size = None if hull.empty else tuple(float(v) for v in np.ptp(hull.points, axis=0))
    return CaptureReport(tuple(problems), offsets, gains, size, len(cameras), sizes)


def pose_problems(cameras: Mapping[str, CalibratedCamera], frame: int) -> Iterator[str]:
    """What is wrong with the cameras whatever their pictures show: unit, number, overlap, the axis that points up."""
    posed = {name: (one.camera, one.pose_of(frame)) for name, one in cameras.items()}
    _, reach = looked_at(list(posed.values()))
    if not NEAREST < reach < FARTHEST:
        wrong = "millimetres or centimetres read as metres" if reach > 1 else "metres read as millimetres"
        yield (
            f"The cameras are {reach:.3g} m from what they look at: {wrong}. Expected: {NEAREST:g} to {FARTHEST:g} m. "
            "Do: set `capture.units` to the unit of the calibration."
        )
        return
    if len(posed) < 2:
        yield "The capture has one camera. Expected: at least two that see the same subject. Do: add cameras."
        return
    for name in posed:
        if (text := _without_overlap(name, posed)) is not None:
            yield text
    if (text := _not_upright(cameras, frame)) is not None:
        yield text


def _without_overlap(name: str, posed: Mapping[str, Posed]) -> str | None:
    """What is said of a camera that has nothing in its picture that the others look at."""
    others = [one for other, one in posed.items() if other != name]
    try:
        volume = common_volume(others, required_views(len(others)))
    except ValueError:
        return None  # the others' own trouble, which their own turn names
    axes = [np.linspace(low, high, 24) for low, high in zip(volume.low, volume.high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    least = required_views(len(others))
    count = np.sum([has_in_picture(camera, pose, points) for camera, pose in others], axis=0)
    camera, pose = posed[name]
    if has_in_picture(camera, pose, points[count >= least]).any():
        return None
    return (
        f"Camera {name} has no overlap: nothing that the other cameras see together lies in its picture. "
        f"Do: check its pose and that its calibration is of the same take, or leave {name} out."
    )


def _not_upright(cameras: Mapping[str, CalibratedCamera], frame: int) -> str | None:
    """What is said of a world whose Z is not up: the tops of most pictures tell."""
    up = -np.mean([one.camera.pose(one.pose_of(frame))[:3, 1] for one in cameras.values()], axis=0)
    axis = int(np.argmax(np.abs(up)))
    if (axis == 2 and up[2] > 0) or abs(up[axis]) < 0.5:
        return None
    said = f"{'-' if up[axis] < 0 else ''}{'xyz'[axis]}"
    return (
        f"The tops of the pictures point along {said} of the world, whose Z must point up. "
        f"Do: set `capture.up` (now the calibration's {said} is up), or leave it if the cameras are mounted so."
    )


def _of_fault(name: str, fault: str) -> str:
    return f"Camera {name} is not used in this frame: {fault}. Do: mend its picture or its matte."


def _of_size(hull: Hull, where: str) -> Iterator[str]:
    if hull.empty:
        yield (
            f"The mattes agree nowhere in space. Where: {where}. Expected: silhouettes of one subject. "
            "Do: check the calibration, the names of the cameras and the mattes."
        )
        return
    side = float(np.ptp(hull.points, axis=0).max())
    if not _SMALLEST < side < _LARGEST:
        yield (
            f"The subject is {side:.3g} m long. Where: {where}. Expected: {_SMALLEST:g} to {_LARGEST:g} m. "
            "Do: set `capture.units`."
        )


def _of_time(offsets: Mapping[str, int], reach: int) -> Iterator[str]:
    for name, late in offsets.items():
        if late:
            farther = f"; `yesnt capture SHOT --sync {4 * reach}` looks farther" if abs(late) == reach else ""
            yield (
                f"Camera {name} is out of sync: its silhouettes agree with the others' {late:+d} frames later. "
                f"Do: add `{name}: {late}` to `capture.offsets`, on top of what stands there{farther}."
            )


def _of_gains(gains: Mapping[str, tuple[float, ...]]) -> Iterator[str]:
    for name, gain in gains.items():
        if max(abs(factor - 1) for factor in gain) > _GAIN:
            said = ", ".join(f"{factor:.3f}" for factor in gain)
            yield (
                f"Camera {name} shows the subject differently bright from the others. "
                f'Do: `"gain": [{said}]` in its entry of a cameras.json brings it to their mean.'
            )


def _read(job: Job, cameras: Mapping[str, CalibratedCamera], frame: int) -> list[View]:
    return [read_view(job, name, one, frame) for name, one in cameras.items()]


def _moments(
    job: Job, cameras: Mapping[str, CalibratedCamera], frame: int, reach: int
) -> dict[int, Sequence[Silhouette]]:
    """Silhouettes of the frames around one, as far as files of the shot go."""
    frames = [f for f in range(frame - 2 * reach, frame + 2 * reach + 1) if f in job.frames]
    return {f: [_reduced(read_silhouette(job, name, one, f)) for name, one in cameras.items()] for f in frames}


def _reduced(view: View | Silhouette) -> Silhouette:
    """A view's matte, reduced if it is large: silhouettes are compared on a grid that is coarser still."""
    times = max(1, max(view.matte.shape) // _SIDE)
    camera = reduced_camera(view.camera, view.pose, times)
    return Silhouette(view.name, camera, view.pose, reduced_image(view.matte, times))


def _crop_pixels(matte: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> int:
    """Pixels of the part of a picture that a fit looks at."""
    sides = [np.flatnonzero((matte > 0).any(axis=axis)) for axis in (1, 0)]
    lengths = [
        min(int(np.ptp(at)) + 1 + 2 * MARGIN, whole) for at, whole in zip(sides, matte.shape, strict=True) if len(at)
    ]
    return int(np.prod(lengths)) if len(lengths) == 2 else 0


def _pairs(views: Sequence[View]) -> list[tuple[Silhouette, np.ndarray[tuple[int, ...], np.dtype[np.float32]]]]:
    return [(Silhouette(view.name, view.camera, view.pose, view.matte), view.radiance) for view in views]
