"""Checks of the capture's pictures before any work: sizes, mattes, colour spaces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict

from yesnt.capture.pictures import check_files
from yesnt.capture.plan import CapturePlan
from yesnt.core.shot import Job
from yesnt.io.cameras import cameras_of
from yesnt.io.color_statements import Statement


class CaptureChecks:
    """Checks the headers of the pictures that measure the materials.

    Args:
        job: the job.
        plan: which cameras measure which frames.
        first: what the first camera's pictures say of their colours.
    """

    def __init__(self, job: Job, plan: CapturePlan, first: Statement) -> None:
        capture = job.shot.captured
        assert capture is not None
        self._job, self._plan, self._first, self._section = job, plan, first, capture
        self._cameras = cameras_of(job.root, capture)

    def depends(self, digests: dict[str, str]) -> Iterator[tuple[int, dict[str, object]]]:
        """Every frame that is measured, and what its check depends on."""
        for frame, names in self._plan.views.items():
            files = [digests[str(path)] for path in CapturePlan({frame: names}).files(self._job)]
            section, stated = self._section.model_dump(mode="json"), asdict(self._first)
            yield frame, {"check": "capture", "frame": frame, "files": files, "reads": section, "stated": stated}

    def check(self, frame: int) -> list[str]:
        """Looks at a frame's pictures; returns nothing that is odd.

        Raises:
            JobError: a picture is missing, of another size than its camera, has no matte, or states another space.
        """
        for name in self._plan.views[frame]:
            check_files(self._job, name, self._cameras[name], frame, self._first)
        return []
