"""What a task has on its desk: the job's inputs and store, a clock, a log, and the record that ends its work."""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import resource
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.errors import CorruptError
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.array_cache import ArrayCache
from yesnt.io.output import OutputFolder
from yesnt.io.records import Record, RecordBook
from yesnt.io.store import FrameStore
from yesnt.planning.graph import Node
from yesnt.tasks.inputs import TaskInputs

Float32 = NDArray[np.float32]

_ARRAYS = ArrayCache()
"""Decoded frames and pictures of this worker process, keyed by the digest of their content."""

_MATTES = ArrayCache(8 << 20)
"""Mattes as bits, a sixtieth of their plates: the solver needs those of many frames, whose plates were evicted."""


class Clock:
    """What a task spends in its kernels, in wall and in processor seconds; reading inside a kernel does not count."""

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self.kernel = self.kernel_processor = 0.0
        self._reading = False
        self._beside = (0.0, 0.0)

    @contextmanager
    def kernel_time(self) -> Iterator[None]:
        """Counts the time inside."""
        start, beside = _now(), self._beside
        try:
            yield
        finally:
            read = _since(beside, self._beside)
            wall, processor = _since(read, _since(start, _now()))
            self.kernel, self.kernel_processor = self.kernel + wall, self.kernel_processor + processor

    @contextmanager
    def reading_time(self) -> Iterator[None]:
        """Takes the time inside away from a kernel around it; the outermost reading counts."""
        if self._reading:
            yield
            return
        start, self._reading = _now(), True
        try:
            yield
        finally:
            spent, self._reading = _since(start, _now()), False
            self._beside = (self._beside[0] + spent[0], self._beside[1] + spent[1])


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.thread_time()


def _since(start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
    return end[0] - start[0], end[1] - start[1]


class Workspace:
    """Reads committed frames, writes whole frames, commits them.

    Args:
        job: the job.
        node: the node that is run.
    """

    def __init__(self, job: Job, node: Node) -> None:
        self.job, self.node = job, node
        self.output = OutputFolder.of(job)
        self.book = RecordBook(self.output.records)
        self.clock = Clock()

    @cached_property
    def store(self) -> FrameStore:
        """The frame store, laid out by the driver."""
        return FrameStore(self.output.store)

    def kernel(self) -> AbstractContextManager[None]:
        """Counts the time inside as kernel time (the rest is reading, writing and waiting)."""
        return self.clock.kernel_time()

    @cached_property
    def inputs(self) -> TaskInputs:
        """The job's input files, proven against the node's key."""
        return TaskInputs(self.job, self.node, self.book)

    def plate(self, frame: int) -> shot_inputs.Plate:
        """The plate of a frame; stages share it, so it must not be written to."""
        key = self._plate_key(frame)
        with self.clock.reading_time():
            plate = _ARRAYS.fetch(
                ("plate", *key),
                lambda: self.inputs.plate(frame, key[0]),
                lambda plate: (plate.color, plate.matte),
            )
            _MATTES.fetch(("matte", *key), lambda: _bits(plate), lambda bits: (bits,))
        return plate

    def matte(self, frame: int) -> NDArray[np.bool_]:
        """Where a frame's matte covers more than half of a pixel, [H, W]."""
        with self.clock.reading_time():
            key = ("matte", *self._plate_key(frame))
            bits = _MATTES.fetch(key, lambda: _bits(self.plate(frame)), lambda bits: (bits,))
            size = self.job.height * self.job.width
            return np.unpackbits(bits, count=size).view(np.bool_).reshape(self.job.height, self.job.width)

    def _plate_key(self, frame: int) -> tuple[str, str, int, int]:
        """Digest of the plate's file, and what its decoding depends on beside that."""
        return self.inputs.digest("plate", frame), self.job.shot.plate.colorspace, self.job.width, self.job.height

    def camera(self) -> Camera:
        """The shot's camera."""
        with self.clock.reading_time():
            return self.inputs.camera()

    def surface(self, frame: int, camera: Camera) -> shot_inputs.Surface:
        """The G-buffer of a frame, normals in world space; not to be written to."""
        digest, seen_by = self.inputs.digest("gbuffer", frame), self.inputs.digest("camera", frame)
        with self.clock.reading_time():
            return _ARRAYS.fetch(
                ("surface", digest, seen_by, self.job.shot.gbuffer, frame, self.job.width, self.job.height),
                lambda: self.inputs.surface(frame, camera, digest),
                lambda surface: (surface.normal, surface.z),
            )

    def read(self, stage: str, array: str, frame: int) -> Float32:
        """A committed frame `[C, H, W]` of another stage, proven against its record; not to be written to.

        Raises:
            CorruptError: not committed, or damaged since.
        """
        digest = self._committed(stage, array, frame)  # of the content: equal digests are equal frames
        with self.clock.reading_time():
            return _ARRAYS.fetch(
                ("frame", digest),
                lambda: self.store.read(array, self.job.position(frame), digest),
                lambda values: (values,),
            )

    def _committed(self, stage: str, array: str, frame: int) -> str:
        """The digest of what another stage committed."""
        record = self.book.find(stage, frame)
        if record is None or array not in record.arrays:
            raise CorruptError(
                f"Stage {stage} has no record of frame {frame}", str(self.book.path(stage, frame)),
                "a record, since this task was started after it", "run again: the frame will be made",
            )  # fmt: skip
        return record.arrays[array]

    def pending(self) -> tuple[int, ...]:
        """The node's frames that have no record with the right key."""
        node = self.node
        return tuple(f for f in node.frames if not self.book.done(node.stage, f, node.frame_key(f)))

    def commit(
        self,
        frame: int,
        arrays: Mapping[str, Float32],
        files: Mapping[str, str] | None = None,
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        """Writes a frame's arrays and then its record, in this order: the record makes it done."""
        position = self.job.position(frame)
        digests = {name: self._keep(name, position, values) for name, values in arrays.items()}
        self._record(frame, digests, files or {}, facts or {})

    def carry(self, frame: int, array: str, source: tuple[str, str], facts: Mapping[str, Any] | None = None) -> None:
        """Commits a frame whose value is that of another stage: its shard gets a second name, its digest is the same.

        Args:
            frame: frame number.
            array: the array that this stage writes.
            source: the other stage and the array that it wrote, of the same form.
            facts: small numbers for reports.
        """
        stage, held = source
        digest = self._committed(stage, held, frame)
        self.store.link(held, array, self.job.position(frame))
        self._record(frame, {array: digest}, {}, facts or {})

    def _record(
        self, frame: int, arrays: Mapping[str, str], files: Mapping[str, str], facts: Mapping[str, Any]
    ) -> None:
        node, seconds = self.node, {"task": self.seconds, "kernel": self.clock.kernel}
        facts = {"host": platform.node(), "peak_bytes": peak_bytes(), **facts}
        fields = node.frame_fields(frame)
        self.book.commit(Record(node.stage, frame, node.frame_key(frame), fields, arrays, files, seconds, facts))

    def _keep(self, name: str, position: int, values: Float32) -> str:
        """Writes one array and caches it: the next stage of this frame most often runs on this worker."""
        digest = self.store.write(name, position, values)
        _ARRAYS.put(("frame", digest), np.array(values, np.float32), values.nbytes)
        return digest

    @property
    def seconds(self) -> float:
        """Time since the task began."""
        return time.perf_counter() - self.clock.began

    def receipt(self) -> dict[str, Any]:
        """The small result that goes back through the scheduler."""
        return {
            "seconds": self.seconds,
            "kernel_seconds": self.clock.kernel,
            "kernel_processor_seconds": self.clock.kernel_processor,
            "worker_processor_seconds": time.process_time(),
            "peak_bytes": peak_bytes(),
            "pid": os.getpid(),
        }

    @contextmanager
    def logged(self) -> Iterator[logging.Logger]:
        """One log per frame and stage; an exception is written with its traceback before it goes on."""
        path = self.output.log_path(self.node.stage, self.node.frames[0])
        path.parent.mkdir(parents=True, exist_ok=True)
        logger = logging.getLogger("yesnt.task")  # one name: the registry of loggers never forgets
        handler = _file_handler(path)
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        logger.propagate = False
        try:
            logger.info(
                "start %s frames %s key %s pid %d", self.node.stage, self.node.frames, self.node.key, os.getpid()
            )
            yield logger
            logger.info("done %.2f s, kernel %.2f s, peak %.0f MB", self.seconds, self.clock.kernel, peak_bytes() / 1e6)
        except Exception:
            logger.exception("failed after %.2f s", self.seconds)
            raise
        finally:
            logger.removeHandler(handler)
            handler.close()


def _bits(plate: shot_inputs.Plate) -> NDArray[np.uint8]:
    """Where a plate's matte covers more than half of a pixel, eight pixels a byte."""
    return np.packbits(plate.matte > 0.5)


def release_memory() -> None:
    """Clears the array cache and gives freed pages back to the system.

    A worker keeps the pages that it freed for its next frame (`cluster.ALLOCATOR`). Before a task with large lists of
    its own, the peak memory of one stage would otherwise add to that of another.
    """
    _ARRAYS.clear()
    trim_memory()


def trim_memory() -> None:
    """Gives freed pages back to the system (glibc; elsewhere they stay): holes between what lives longer add up."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


class _LogFile(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:
        """A log that finds no room on the disk stays silent: the task says what went wrong."""


def _file_handler(path: Path) -> logging.Handler:
    handler = _LogFile(path, mode="a", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    return handler
