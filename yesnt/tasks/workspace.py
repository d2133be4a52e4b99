"""Inputs and outputs of one task: decoded inputs, committed frames of other stages, and its own commits."""

from __future__ import annotations

import logging
import os
import platform
import time
from collections.abc import Hashable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.errors import CorruptError
from yesnt.core.shot import Job
from yesnt.core.stage_id import StageId
from yesnt.io import shot_inputs
from yesnt.io.lease import Lease, take_lease
from yesnt.io.output import OutputFolder
from yesnt.io.records import Record, RecordBook, file_state
from yesnt.io.store import FrameStore
from yesnt.planning.graph import Node
from yesnt.planning.task_records import TaskRecord
from yesnt.tasks import decoded
from yesnt.tasks.clock import Clock
from yesnt.tasks.inputs import TaskInputs
from yesnt.tasks.memory import peak_bytes
from yesnt.tasks.task_log import open_log

Float32 = NDArray[np.float32]
T_co = TypeVar("T_co", bound=TaskRecord, covariant=True)


class Workspace(Generic[T_co]):
    """Reads inputs and committed frames, writes whole frames, commits them.

    Args:
        job: the job.
        node: the node that is run; its task record is of the type that the workspace is generic in.
    """

    def __init__(self, job: Job, node: Node) -> None:
        self.job, self.node = job, node
        self.output = OutputFolder.of(job)
        self.book = RecordBook(self.output.records, self.output.root)
        self.clock = Clock()
        self._lease: Lease | None = None

    @property
    def task(self) -> T_co:
        """The task's arguments besides the job."""
        return self.node.task  # type: ignore[return-value]

    @property
    def frame(self) -> int:
        """The node's frame, or its first."""
        return self.node.frames[0]

    @cached_property
    def store(self) -> FrameStore:
        """The frame store, laid out by the driver."""
        return FrameStore(self.output.store)

    def kernel(self) -> AbstractContextManager[None]:
        """Counts the time inside as kernel time; the rest is reading, writing and waiting."""
        return self.clock.kernel_time()

    @cached_property
    def inputs(self) -> TaskInputs:
        """The job's input files, checked against the node's key."""
        return TaskInputs(self.job, self.node, self.book)

    def plate(self, frame: int, working: bool = False) -> shot_inputs.Plate:
        """The plate of a frame, in linear Rec.709 or in the working space. Read only: other stages share it."""
        key = self._plate_key(frame, working)
        with self.clock.reading_time():
            plate = decoded.FRAMES.fetch(
                ("plate", *key),
                lambda: self.inputs.plate(frame, working),
                lambda plate: plate.arrays,
            )
            decoded.MATTES.fetch(("matte", *key), lambda: _bits(plate), lambda bits: (bits,))
        return plate

    def matte(self, frame: int) -> NDArray[np.bool_]:
        """Where a frame's matte covers more than half of a pixel, [H, W]."""
        with self.clock.reading_time():
            key = ("matte", *self._plate_key(frame))
            bits = decoded.MATTES.fetch(key, lambda: _bits(self.plate(frame)), lambda bits: (bits,))
            size = self.job.height * self.job.width
            return np.unpackbits(bits, count=size).view(np.bool_).reshape(self.job.height, self.job.width)

    def _plate_key(self, frame: int, working: bool = False) -> tuple[Hashable, ...]:
        """Digests of the plate's files, and what their decoding depends on besides."""
        colors = self.job.colors
        conversion = colors.plate_working if working else colors.plate
        return *self.inputs.plate_digests(frame).values(), self._plate_reading, conversion

    @cached_property
    def _plate_reading(self) -> str:
        """What the decoding of a plate depends on besides its files: sections of the job, and its pixels."""
        shot = self.job.shot
        sections = (section.model_dump_json() for section in (shot.plate, shot.matte) if section is not None)
        return f"{'; '.join(sections)}; {self.job.window}; {self.job.display_size}"

    def camera(self) -> Camera:
        """The shot's camera."""
        with self.clock.reading_time():
            return self.inputs.camera()

    def surface(self, frame: int, camera: Camera) -> shot_inputs.Surface:
        """The G-buffer of a frame, normals in world space. Read only: other stages share it."""
        digest, seen_by = self.inputs.digest("gbuffer", frame), self.inputs.digest("camera", frame)
        with self.clock.reading_time():
            return decoded.FRAMES.fetch(
                ("surface", digest, seen_by, self.job.shot.gbuffer, frame, self.job.window, self.job.display_size),
                lambda: self.inputs.surface(frame, camera, digest),
                lambda surface: (surface.normal, surface.z),
            )

    def read(self, stage: StageId, channel: str, frame: int) -> Float32:
        """A channel `[C, H, W]` that another stage committed, checked against its record. Read only.

        Raises:
            CorruptError: not committed, or damaged since.
        """
        array = stage.array(channel)
        digest = self._committed(stage, array, frame)  # of the content: equal digests are equal frames
        with self.clock.reading_time():
            return decoded.FRAMES.fetch(
                ("frame", digest),
                lambda: self.store.read(array, self.job.position(frame), digest),
                lambda values: (values,),
            )

    def _committed(self, stage: StageId, array: str, frame: int) -> str:
        """The digest of an array that another stage committed."""
        record = self.book.find(stage, frame)
        if record is None or array not in record.arrays:
            raise CorruptError(
                f"Stage {stage} has no record of frame {frame}", str(self.book.path(stage, frame)),
                "a record, since this task was started after it", "run again: the frame will be made",
            )  # fmt: skip
        return record.arrays[array]

    def committed_file(self, stage: StageId, frame: int, path: Path) -> str:
        """The digest of a file that another stage committed.

        Raises:
            CorruptError: not committed.
        """
        record, name = self.book.find(stage, frame), str(path.relative_to(self.output.root))
        if record is None or name not in record.files:
            raise CorruptError(
                f"Stage {stage} has no record of {name}", str(self.book.path(stage, frame)),
                "a record, since this task was started after it", "run again: it will be made",
            )  # fmt: skip
        return record.files[name]

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Holds the node's lease, so that no two workers write the same frames.

        A worker that is cut off from its scheduler works on while its task is given to another one, which waits here
        until the first is done or gone.
        """
        name = f"{self.node.stage}.{self.frame:04d}"
        self._lease = take_lease(self.output.task_leases, name, patient=True)
        assert self._lease is not None, "a patient claim waits"
        try:
            yield
        finally:
            self._lease.release()

    def pending(self) -> tuple[int, ...]:
        """The node's frames that have no record with the right key."""
        node = self.node
        return tuple(f for f in node.frames if not self.book.done(node.stage, f, node.frame_key(f)))

    def commit(
        self,
        frame: int,
        channels: Mapping[str, Float32],
        files: Mapping[str, str] | None = None,
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        """Writes a frame's channels and then its record, in this order: the record makes it done.

        Args:
            frame: frame number.
            channels: `[C, H, W]` by channel, stored in this stage's arrays.
            files: path relative to the output folder -> digest, of files that are on disk already.
            facts: small numbers for reports.
        """
        position, stage = self.job.position(frame), self.node.stage
        digests = {stage.array(name): self._keep(stage.array(name), position, v) for name, v in channels.items()}
        self._record(frame, digests, files or {}, facts or {})

    def carry(self, frame: int, channel: str, source: StageId, facts: Mapping[str, Any] | None = None) -> None:
        """Commits a frame whose value is another stage's: a hard link to its shard, with the same digest.

        Args:
            frame: frame number.
            channel: the channel, stored by both stages in arrays of the same shape.
            source: the other stage.
            facts: small numbers for reports.
        """
        held, array = source.array(channel), self.node.stage.array(channel)
        digest = self._committed(source, held, frame)
        self.store.link(held, array, self.job.position(frame))
        self._record(frame, {array: digest}, {}, facts or {})

    def _record(
        self, frame: int, arrays: Mapping[str, str], files: Mapping[str, str], facts: Mapping[str, Any]
    ) -> None:
        node, seconds = self.node, {"task": self.clock.seconds, "kernel": self.clock.kernel}
        facts = {"host": platform.node(), "peak_bytes": peak_bytes(), **facts}
        fields, key = node.frame_fields(frame), node.frame_key(frame)
        states = {name: file_state(self.output.root / name) for name in files}
        self._confirm()
        self.book.commit(Record(node.stage.label, frame, key, fields, arrays, files, seconds, facts, states))

    def _confirm(self) -> None:
        """Stops a worker whose frames another one has taken over."""
        if self._lease is not None:
            self._lease.confirm()

    def _keep(self, name: str, position: int, values: Float32) -> str:
        """Writes one array and caches it: the next stage of this frame most often runs in this process."""
        self._confirm()
        digest = self.store.write(name, position, values)
        decoded.FRAMES.put(("frame", digest), np.array(values, np.float32), values.nbytes)
        return digest

    def receipt(self) -> dict[str, Any]:
        """The small result that goes back through the scheduler."""
        return {
            "seconds": self.clock.seconds,
            "kernel_seconds": self.clock.kernel,
            "kernel_processor_seconds": self.clock.kernel_processor,
            "worker_processor_seconds": time.process_time(),
            "peak_bytes": peak_bytes(),
            "pid": os.getpid(),
        }

    @contextmanager
    def logged(self) -> Iterator[logging.Logger]:
        """Writes the start and the end of the task, or its exception, to the log of its stage and first frame."""
        node = self.node
        with open_log(self.output.log_path(node.stage, self.frame)) as logger:
            logger.info("start %s frames %s key %s pid %d", node.stage, node.frames, node.key, os.getpid())
            yield logger
            seconds, peak = self.clock.seconds, peak_bytes() / 1e6
            logger.info("done %.2f s, kernel %.2f s, peak %.0f MB", seconds, self.clock.kernel, peak)


def _bits(plate: shot_inputs.Plate) -> NDArray[np.uint8]:
    """Where a plate's matte covers more than half of a pixel, eight pixels in a byte."""
    return np.packbits(plate.matte > 0.5)
