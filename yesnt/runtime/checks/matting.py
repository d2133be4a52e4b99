"""Checks of the pictures that mattes are made from, before any matte."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path

from yesnt.capture.files import VIEW, camera_files
from yesnt.capture.pictures import check_files, check_plate
from yesnt.capture.samples import background_files
from yesnt.core.errors import JobError
from yesnt.core.matting_input import MEDIAN
from yesnt.core.shot import Job
from yesnt.io.cameras import CalibratedCamera, cameras_of
from yesnt.io.color_statements import Statement
from yesnt.io.fact_cache import FactCache
from yesnt.io.records import digest_of
from yesnt.io.video import is_video, video_index
from yesnt.runtime.checks.fitted import refuse_other_rates

LEAST_PICTURES = 3
"""Pictures of a camera from which a median over time can tell the background."""


class MattingChecks:
    """Checks of a job that makes the mattes of its capture.

    Args:
        job: the job.
        facts: what was found before.
        digests: of all input files, by path.
        first: what the first camera's pictures say of their colours.
        code: digest of the modules that check.

    Raises:
        JobError: a camera moves, so that it has no background; or a median has too few pictures.
    """

    def __init__(self, job: Job, facts: FactCache, digests: Mapping[str, str], first: Statement, code: str) -> None:
        capture = job.shot.matted
        assert capture is not None
        assert capture.matting is not None
        self._job, self._facts, self._digests, self._capture, self._first = job, facts, digests, capture, first
        self._matting, self._cameras = capture.matting, cameras_of(job.root, capture)
        self._depends = {"code": code, "reads": capture.model_dump(mode="json"), "stated": asdict(first)}
        for name, camera in self._cameras.items():
            self._refuse_without_background(name, camera)

    def headers(self, frame: int) -> None:
        """Looks at the headers of all pictures of a frame, and once at those of the clean plates.

        Raises:
            JobError: a picture is missing, of another size than its camera, or states another colour space; or videos
                run at different rates.
        """
        videos: dict[str, Path] = {}
        for name, camera in self._cameras.items():
            path = camera_files(self._job.root, self._capture, name, frame)[VIEW]
            videos |= {f"{VIEW} {name}": path} if is_video(path) else {}
            about = {"check": "matting", "camera": name, "file": self._digests[str(path)], "frame": frame}
            self._facts.fetch(digest_of({**self._depends, **about}), partial(self._check, name, camera, frame))
        if frame == self._job.frames[0]:
            refuse_other_rates(videos)
            for name, camera in self._cameras.items():
                self._check_clean(name, camera)

    def poses(self) -> Iterator[str]:
        """What is wrong with the calibration, whatever the pictures show.

        Raises:
            JobError: the cameras have nothing in common, so that no hull can make their mattes agree.
        """
        from yesnt.capture.hull import required_views
        from yesnt.capture.report import pose_problems  # imports Numba's kernels
        from yesnt.capture.volume import common_volume

        frame = self._job.frames[0]
        yield from (f"capture, frame {frame}: {problem}" for problem in pose_problems(self._cameras, frame))
        if not self._matting.consistent or len(self._cameras) < 2:
            return
        for frame in self._job.probe_frames:
            posed = [(one.camera, one.pose_of(frame)) for one in self._cameras.values()]
            try:
                common_volume(posed, required_views(len(posed)))
            except ValueError as error:
                raise JobError(
                    f"The mattes cannot be made to agree in frame {frame}: {error}", self._capture.cameras,
                    "cameras that look at one subject", "check `units`, `up` and the poses, or set `consistent: false`",
                ) from error  # fmt: skip

    def _check(self, name: str, camera: CalibratedCamera, frame: int) -> list[str]:
        check_files(self._job, name, camera, frame, self._first, mattes=False)
        return []

    def _check_clean(self, name: str, camera: CalibratedCamera) -> None:
        if self._matting.clean_plates is not None:
            for path in background_files(self._job, name).values():
                check_plate(self._job, name, camera, path, self._first)

    def _refuse_without_background(self, name: str, camera: CalibratedCamera) -> None:
        """Refuses a camera whose background is not the same in all frames, or not to be told from its pictures."""
        if self._matting.has_background and not camera.still:
            raise JobError(
                f"Camera {name} of the capture moves, and its background with it", "key capture.matting.background",
                "cameras at rest (`world_from_camera` in cameras.json)",
                "set `background: none` with `person: true`, or bring mattes",
            )  # fmt: skip
        if self._matting.background != MEDIAN:
            return
        files = list(background_files(self._job, name).values())
        count = len(video_index(files[0]).stamps) if is_video(files[0]) else len(files)
        if count < LEAST_PICTURES:
            raise JobError(
                f"Camera {name} has {count} picture{'s' * (count > 1)}, whose median is not the background",
                "key capture.matting.background", f"at least {LEAST_PICTURES} pictures in which the subject moves",
                "name clean plates, or set `background: none` with `person: true`",
            )  # fmt: skip
