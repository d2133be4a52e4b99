"""Input files of a task, identified by content.

A worker may serve several runs, and a camera, light or plate may be replaced under the same path between them. So every
cache of a worker is keyed by the digest that the task's key holds, and a file that is read is compared with it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.corrections import read_overrides
from yesnt.io.file_digests import file_digest
from yesnt.io.jobfile import correction_patterns, frame_path, pass_files
from yesnt.io.pictures.shot_raster import for_raster
from yesnt.io.records import RecordBook
from yesnt.planning.graph import Node
from yesnt.planning.stages import CORRECT, DECOMPOSE, EVIDENCE, FLOW, RELIGHT

if TYPE_CHECKING:
    import numpy as np

    from yesnt.decompose.corrections import Override
    from yesnt.io.mesh import Mesh

T = TypeVar("T")

_READERS_OF_INPUTS = (RELIGHT, CORRECT, EVIDENCE, DECOMPOSE, FLOW)
"""Stages whose records name plates, G-buffers and cameras; a later stage looks their digests up there."""


def read_checked(path: Path, digest: str | None, read: Callable[[], T]) -> T:
    """Reads a file and proves that it is the one with this digest (None: there is nothing to compare with).

    The digest is taken after reading, so that a file that is replaced in between is noticed too.

    Raises:
        JobError: the file is another one.
    """
    value = read()
    prove_input(path, digest)
    return value


def prove_input(path: Path, digest: str | None) -> None:
    """Raises JobError unless the file has this digest; None passes."""
    if digest is not None and file_digest(path) != digest:
        raise input_changed(path)


def input_changed(path: Path) -> JobError:
    """The error of an input that was replaced after its digest was taken."""
    return JobError(
        "An input has changed while the job runs", str(path), "the file that the run began with",
        "run again: what depends on it is made anew",
    )  # fmt: skip


class TaskInputs:
    """Reads the input files of a task.

    Args:
        job: the job.
        node: the node that runs; its fields name the inputs and their digests.
        book: records of the stages before, for inputs that the node depends on through them.
    """

    def __init__(self, job: Job, node: Node, book: RecordBook) -> None:
        self._job, self._node, self._book = job, node, book
        self._known: dict[tuple[str, int], str] = {}

    def digest(self, role: str, frame: int) -> str:
        """The digest of the file that a role (`plate`, `matte`, `gbuffer`, `camera`) has in a frame.

        It is what the node's key, or a record that the key includes, says of the file; of another file it is computed.
        """
        if (role, frame) not in self._known:  # a joint solve asks for every frame's plate several times
            known = self._own(role, frame) or self._recorded(role, frame)
            self._known[role, frame] = known or file_digest(self.path(role, frame))
        return self._known[role, frame]

    def path(self, role: str, frame: int) -> Path:
        """The file of a role in a frame."""
        shot = self._job.shot
        patterns = {"plate": shot.plate.path, "gbuffer": shot.gbuffer.path, "camera": shot.camera}
        patterns |= {"matte": shot.matte.path} if shot.matte else {}
        patterns |= {"proxy": shot.proxy.path} if shot.proxy else {}
        patterns |= {"mesh": shot.set.mesh} if shot.set and shot.set.mesh else {}
        return frame_path(self._job.root, patterns[role], frame)

    def camera(self) -> Camera:
        """The shot's camera; kept in the worker."""
        frame = self._node.frames[0]
        return for_raster(_camera(self.path("camera", frame), self.digest("camera", frame)), self._job)

    def plate_digests(self, frame: int) -> dict[str, str]:
        """Digests of the files that the plate of a frame is read from, by role."""
        roles = ("plate", "matte") if self._job.shot.matte else ("plate",)
        return {role: self.digest(role, frame) for role in roles}

    def plate(self, frame: int, working: bool = False) -> shot_inputs.Plate:
        """The plate of a frame, with its matte, in linear Rec.709 or in the working space.

        Its files are those of `plate_digests`.
        """
        found = shot_inputs.read_plate(self._job, frame, working)
        for role, digest in self.plate_digests(frame).items():
            prove_input(self.path(role, frame), digest)
        return found

    def surface(self, frame: int, camera: Camera, digest: str) -> shot_inputs.Surface:
        """The G-buffer of a frame, which has this digest; normals in world space."""
        read = shot_inputs.read_surface
        return read_checked(self.path("gbuffer", frame), digest, lambda: read(self._job, frame, camera))

    def passes(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Mean and spread [2, H, W] of the material passes of the node's frame."""
        found = shot_inputs.read_passes(self._job, self._node.frames[0])
        for name, pattern in pass_files(self._job.shot.decompose).items():
            self._prove(name, pattern)
        return found

    def overrides(self, matte: NDArray[np.float32]) -> list[Override]:
        """Corrections of the materials of the node's frame, whose matte [H, W] this is."""
        found, _ = read_overrides(self._job, self._node.frames[0], matte)
        for role, pattern in correction_patterns(self._job.shot).items():
            self._prove(role, pattern)
        return found

    def flow(self) -> NDArray[np.float32]:
        """The precomputed flow [H, W, 2] of the node's frame, pixels."""
        found = shot_inputs.read_flow(self._job, self._node.frames[0])
        self._prove("flow", self._job.shot.flow.path)
        return found

    def background(self) -> NDArray[np.float32] | None:
        """The background [H, W, 4] of the node's frame, or None if the job names none."""
        if self._job.shot.background is None:
            return None
        found = shot_inputs.read_background(self._job, self._node.frames[0])
        self._prove("background", self._job.shot.background.path)
        return found

    def proxy(self, frame: int | None = None) -> Mesh | None:
        """The proxy mesh of a frame, by default the node's, or None if the job names none."""
        if self._job.shot.proxy is None:
            return None
        from yesnt.io.mesh import read_proxy

        frame = self._node.frames[0] if frame is None else frame
        mesh = read_proxy(self._job, frame)
        self.prove("proxy", frame)
        return mesh

    def prove(self, role: str, frame: int) -> None:
        """Raises JobError unless the file that a role has in a frame is the one that the node's key names."""
        prove_input(self.path(role, frame), self.digest(role, frame))

    def _prove(self, role: str, pattern: str | None) -> None:
        assert pattern is not None
        prove_input(frame_path(self._job.root, pattern, self._node.frames[0]), self._node.inputs.get(role))

    def _own(self, role: str, frame: int) -> str | None:
        """The digest that the node's own fields hold."""
        inputs, first = self._node.inputs, self._node.frames[0]
        if f"{role} {frame}" in inputs:
            return inputs[f"{role} {frame}"]
        if frame == first:
            return inputs.get(role)
        follows = self._job.position(frame) == self._job.position(first) + 1
        return inputs.get(f"next_{role}") if follows else None

    def _recorded(self, role: str, frame: int) -> str | None:
        """The digest in the record of a stage that the node's key includes."""
        upstream = self._node.fields.get("upstream", {})
        for stage in (stage for stage in _READERS_OF_INPUTS if stage.label in upstream):
            record = self._book.find(stage, frame)
            if record is not None and role in record.fields.get("inputs", {}):
                found: str = record.fields["inputs"][role]
                return found
        return None


@lru_cache(maxsize=4)
def _camera(path: Path, digest: str) -> Camera:
    return read_checked(path, digest, lambda: Camera.open(path))
