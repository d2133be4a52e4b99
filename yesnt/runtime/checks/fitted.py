"""Checks of the pictures that Gaussian fields are fitted to, before any fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from yesnt.capture.files import camera_files
from yesnt.capture.pictures import check_files
from yesnt.core.capture_input import CaptureCameras
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.io.cameras import CalibratedCamera, calibration_roles, cameras_of
from yesnt.io.color_statements import Statement
from yesnt.io.fact_cache import FactCache
from yesnt.io.records import digest_of
from yesnt.io.video import is_video, video_index

SAME_RATE = 5e-4
"""Share by which frame rates of videos may differ: 30 and 29.97 frames a second drift apart, rounded stamps do not."""


REACH = 1
"""Largest offset of a camera in time that is looked for before a fit, frames; `yesnt capture --sync` looks farther."""


class FittedChecks:
    """Checks of a job that fits its fields itself.

    Args:
        job: the job.
        facts: what was found before.
        digests: of all input files, by path.
        first: what the first camera's pictures say of their colours.
        code: digest of the modules that check.
    """

    def __init__(
        self, job: Job, facts: FactCache, digests: Mapping[str, str], first: Statement, code: str
    ) -> None:  # fmt: skip
        assert job.shot.capture is not None
        self._job, self._facts, self._digests, self._capture = job, facts, digests, job.shot.capture
        self._depends = {"code": code, "reads": self._capture.model_dump(mode="json"), "stated": asdict(first)}
        self._first, self._cameras = first, cameras_of(job.root, self._capture)

    def headers(self, frame: int) -> None:
        """Looks at the headers of all pictures of a frame.

        Raises:
            JobError: a picture is missing, of another size than its camera, has no matte, or states another space; or
                videos run at different rates.
        """
        videos: dict[str, Path] = {}
        for name, camera in self._cameras.items():
            files = camera_files(self._job.root, self._capture, name, frame)
            videos |= {f"{role} {name}": path for role, path in files.items() if is_video(path)}
            about = {"check": "fitted", "camera": name, "files": self._known(files), "frame": frame}
            key = digest_of({**self._depends, **about})
            self._facts.fetch(key, partial(_check_header, self._job, name, camera, frame, self._first))
        if frame == self._job.frames[0]:
            refuse_other_rates(videos)

    def agreement(self) -> Iterator[str]:
        """What is wrong with the capture in a few frames, each fault once; `report_capture` says what is looked at.

        Time is looked at in the middle frame, if the shot holds the frames around it. A frame that cannot be fitted is
        a warning as long as another can: it fails by itself.

        Raises:
            JobError: the mattes agree in none of these frames, so that there is nothing to fit.
        """
        told, reports = set[str](), {frame: self._report(frame) for frame in self._job.probe_frames}
        lost = [frame for frame, report in reports.items() if report["nothing"]]
        if len(lost) == len(reports):
            raise _nothing_to_fit(self._capture, lost[0], reports[lost[0]]["problems"])
        for frame, report in reports.items():
            if frame in lost:
                yield f"capture, frame {frame}: its fit will fail, and all other frames are made without it"
            for problem in report["problems"]:
                if (fault := problem.split(" (")[0]) not in told:
                    told.add(fault)
                    yield f"capture, frame {frame}: {problem}"

    def sizes(self) -> list[tuple[int, int]]:
        """Pixels of each camera's picture and of its crop, in the frame where the crops are the largest."""
        found = [self._report(frame)["sizes"] for frame in self._job.probe_frames]
        largest = max(found, key=lambda sizes: sum(crop for _, crop in sizes.values()))
        return [(whole, crop) for whole, crop in largest.values()]

    def _report(self, frame: int) -> dict[str, Any]:
        roles: dict[str, str] = {}
        for name in self._cameras:
            files = camera_files(self._job.root, self._capture, name, frame)
            roles |= {f"{role} {name}": digest for role, digest in self._known(files).items()}
        roles |= self._known(calibration_roles(self._job.root, self._capture))
        frames = self._job.frames
        around = frames_around(frames, frame) if frame == frames[(len(frames) - 1) // 2] else ()
        for other in around:
            for name in self._cameras:
                files = camera_files(self._job.root, self._capture, name, other)
                roles |= {f"{role} {name} {other}": digest for role, digest in self._known(files).items()}
        about = {"check": "agreement", "frame": frame, "files": roles, "colors": asdict(self._job.colors.capture)}
        fact: dict[str, Any] = self._facts.fetch(
            digest_of({**self._depends, **about}),
            partial(_examine, self._job, self._cameras, frame, REACH if around else 0),
        )
        return fact

    def _known(self, files: Mapping[str, Path]) -> dict[str, str]:
        return {role: self._digests[str(path)] for role, path in files.items()}


def _check_header(job: Job, name: str, camera: CalibratedCamera, frame: int, first: Statement) -> list[str]:
    check_files(job, name, camera, frame, first)
    return []


def frames_around(frames: Sequence[int], frame: int) -> tuple[int, ...]:
    """The frames that show whether cameras are in time in one of a shot's frames; none if the shot lacks one."""
    around = tuple(range(frame - 2 * REACH, frame + 2 * REACH + 1))
    return around if set(around) <= set(frames) else ()


def _examine(job: Job, cameras: Mapping[str, CalibratedCamera], frame: int, reach: int) -> dict[str, Any]:
    from yesnt.capture.report import pose_problems, report_capture  # imports Numba's kernels

    found = report_capture(job, frame, reach)
    nothing = found.subject is None and not list(pose_problems(cameras, frame))
    sizes = {name: list(size) for name, size in found.sizes.items()}
    return {"problems": list(found.problems), "sizes": sizes, "nothing": nothing}


def _nothing_to_fit(capture: CaptureCameras, frame: int, problems: Sequence[str]) -> JobError:
    return JobError(
        f"The capture cannot be fitted in frame {frame}: {' '.join(problems)}", capture.cameras,
        "silhouettes of one subject, seen by calibrated cameras in one world",
        "check the calibration, the names of the cameras and the mattes; `yesnt capture SHOT` looks again",
    )  # fmt: skip


def refuse_other_rates(videos: Mapping[str, Path]) -> None:
    """Refuses videos of different frame rates: picture N of one is not of the same moment as picture N of another.

    Args:
        videos: by role and camera.

    Raises:
        JobError: two rates differ.
    """
    rates = {who: float(video_index(path).rate) for who, path in videos.items() if len(video_index(path).stamps) > 1}
    if not rates:
        return
    usual = sorted(rates.values())[len(rates) // 2]
    others = [who for who, rate in rates.items() if abs(rate - usual) > SAME_RATE * usual]
    if others:
        said = ", ".join(f"{who}: {rates[who]:.6g}" for who in others)
        raise JobError(
            f"Videos of the capture run at another frame rate than the others ({said} frames a second)",
            str(videos[others[0]]), f"{usual:.6g} frames a second, as most have",
            "convert them to one rate (`ffmpeg -i IN -r RATE OUT`), or export pictures by frame number",
        )  # fmt: skip
