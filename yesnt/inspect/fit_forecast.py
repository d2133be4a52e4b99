"""What fits of Gaussian fields would cost: a model of steps, Gaussians and pixels, scaled by what was measured."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import replace

from yesnt.gaussians.cost import FitLoad, count_at, fit_bytes, fit_seconds
from yesnt.gaussians.settings import FitSettings
from yesnt.io.record_index import RecordIndex
from yesnt.planning import settings as of
from yesnt.planning.graph import Node
from yesnt.planning.task_records import FitTask
from yesnt.runtime.session import Session


class FitForecast:
    """Predicts the fits of a job.

    Args:
        session: a job that fits its fields.
    """

    def __init__(self, session: Session) -> None:
        sizes = session.checks.fit_sizes()
        self._settings = of.fit_settings(session.job.shot)
        count = max(len(sizes), 1)
        self._pixels = tuple(sum(size[i] for size in sizes) / count for i in (0, 1))

    def seconds(self, todo: Sequence[Node], nodes: Sequence[Node], index: RecordIndex) -> tuple[float, bool]:
        """Seconds of the nodes that would run, and whether this job's records scale the model."""
        entries = [(node, index.find(node.stage, node.frames[0])) for node in nodes]
        ratios = [entry.seconds / self._seconds_of(node) for node, entry in entries if entry is not None]
        scale = statistics.median(ratios) if ratios else 1.0
        return scale * sum(self._seconds_of(node) for node in todo), bool(ratios)

    def peak_bytes(self, nodes: Sequence[Node]) -> float:
        """Most memory of a worker over all fits."""
        return max((fit_bytes(self._settings_of(node), self._load(node)) for node in nodes), default=0.0)

    def _seconds_of(self, node: Node) -> float:
        return fit_seconds(self._settings_of(node), self._load(node))

    def _settings_of(self, node: Node) -> FitSettings:
        """A frame between keyframes starts with all Gaussians of its keyframe, and does not split them."""
        assert isinstance(node.task, FitTask)
        if node.task.keyframe is None:
            return self._settings
        return replace(self._settings.following(), count=count_at(self._settings.steps, self._settings))

    def _load(self, node: Node) -> FitLoad:
        assert isinstance(node.task, FitTask)
        return FitLoad(len(node.task.cameras), len(node.task.held_out), *self._pixels)
