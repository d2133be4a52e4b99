"""Measures each setting against its stage's reference, and writes the curve of seconds against error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from yesnt.core.errors import UsageError
from yesnt.io.durable import write_bytes, write_json
from yesnt.measure.trade.choose import Point, cheapest
from yesnt.measure.trade.evidence import EvidenceRunner
from yesnt.measure.trade.harness import Found, Harness, true_materials
from yesnt.measure.trade.plot import plot_svg
from yesnt.measure.trade.variants import STAGES, Variant, variants
from yesnt.runtime.session import Session

Listener = Callable[[str], None]


class Runner(Protocol):
    """Runs the variants of a stage."""

    def __call__(self, variant: Variant) -> Found:
        """What a variant shows and costs."""
        ...

    def truth(self, stage: str) -> np.ndarray | None:
        """What true materials show instead; None if it is not known or the stage does not decide on them."""
        ...


@dataclass(frozen=True)
class TradeOptions:
    """Options of `yesnt trade`.

    Attributes:
        frames: number of consecutive frames, from the middle of the shot; at least 2.
        error: largest acceptable error.
        seconds: largest acceptable processor seconds per frame.
    """

    frames: int = 6
    error: float | None = None
    seconds: float | None = None


def run_trade(session: Session, options: TradeOptions, listen: Listener = lambda line: None) -> dict[str, Any]:
    """Measures every variant; writes `trade.json` and `trade.svg` into the run folder; returns the document.

    Error is the root mean square difference, display-referred and inside the matte, between the middle frame relit with
    the variant and with the stage's reference, all other stages alike; of the evidence it is that of all frames. The
    other stages are measured without the evidence. Seconds are of this processor, one thread.

    Raises:
        UsageError: the shot reads its materials from passes, or has too few frames.
    """
    import torch

    torch.set_num_threads(1)
    harness = Harness(session, _middle(session, options.frames))
    steps = (1, 2, 4) if session.job.shot.decompose.backend == "embedded" else ()
    points, tried = [], variants(steps)
    base = next(v for v in tried if v.stage == "decompose")
    runners: dict[str, Runner] = dict.fromkeys(STAGES, _VariantRunner(harness, base))
    if (measured := EvidenceRunner.of(session, harness.frames, base)) is not None:
        runners["evidence"] = measured
        tried += measured.variants
    for stage in sorted({v.stage for v in tried}, key=STAGES.index):
        of_stage = [v for v in tried if v.stage == stage]
        points += _points(of_stage, runners[stage], listen)
    choice = cheapest(points, options.error, options.seconds)
    jobs = {(v.stage, v.name): v.job for v in tried}
    document = {
        "frames": list(harness.frames),
        "points": [asdict(point) for point in points],
        "asked": {"error": options.error, "seconds_per_frame": options.seconds},
        "choice": None if choice is None else asdict(choice),
        "job": {} if choice is None else _merged([jobs[item] for item in choice.names.items()]),
    }
    folder = session.output.run
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "trade.json", document)
    write_bytes(folder / "trade.svg", plot_svg(points).encode())
    return document | {"files": [str(folder / "trade.json"), str(folder / "trade.svg")]}


def _points(variants: list[Variant], run: Runner, listen: Listener) -> list[Point]:
    """The points of one stage, its reference first."""
    *others, best = variants
    reference, true = run(best), run.truth(best.stage)
    points = [_point(best, reference, reference.shown, true)]
    for variant in others:
        points.append(_point(variant, run(variant), reference.shown, true))
        found = points[-1]
        listen(f"{found.stage}: {found.name}: {found.seconds:.2f} s per frame, error {found.error:.5f}")
    return points


class _VariantRunner:
    """Runs a variant; results of the other stages are cached."""

    def __init__(self, harness: Harness, base: Variant) -> None:
        self._harness, self._base = harness, base
        self._observed: dict[str, Any] = {}

    def truth(self, stage: str) -> np.ndarray | None:
        """The middle frame relit with true materials, for the stage that decides on them; None without truth."""
        harness = self._harness
        planes = true_materials(harness, (harness.middle,)) if stage == "decompose" else None
        return None if planes is None else harness.shown(planes, self._base.quality)[0]

    def __call__(self, variant: Variant) -> Found:
        """The middle frame under a variant, and the cost of its stage."""
        harness, base = self._harness, self._base
        own = variant if variant.stage == "decompose" else base
        if own.name not in self._observed:
            self._observed = {base.name: self._observed.get(base.name)} if base.name in self._observed else {}
            self._observed[own.name] = harness.observe(own.ensemble, own.knobs, base.method)
        mean, std, drawn = self._observed[own.name]
        fused, solved = harness.fuse(mean, std, variant.method, variant.tolerance)
        shown, relit = harness.shown(fused, variant.quality)
        relit.seconds *= len(harness.frames)  # one frame was relit
        costs = {"decompose": drawn, "flow": harness.links(variant.method)[1], "solve": solved, "relight": relit}
        cost, frames = costs[variant.stage], len(harness.frames)
        return Found(shown, cost.seconds / frames, cost.evaluations / frames)


def _point(variant: Variant, found: Found, reference: np.ndarray, true: np.ndarray | None) -> Point:
    error = _difference(found.shown, reference)
    from_truth = None if true is None else _difference(found.shown, true)
    return Point(variant.stage, variant.name, found.seconds, error, found.evaluations, from_truth)


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2, dtype=np.float64)))


def _middle(session: Session, count: int) -> tuple[int, ...]:
    frames = session.job.frames
    if session.resolved.backend is None or session.resolved.backend.footprint.window or len(frames) < 2 or count < 2:
        raise UsageError(
            "There is nothing to trade", "SHOT", "a backend that draws frame by frame, and at least two frames",
            "name one under decompose.backend",
        )  # fmt: skip
    count = min(count, len(frames))
    start = (len(frames) - count) // 2
    return frames[start : start + count]


def _merged(documents: list[dict[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for document in documents:
        found |= document
    return found


def read_trade(run: Path) -> dict[str, Any] | None:
    """The document of an earlier `yesnt trade`; None if there is none."""
    import json

    path = run / "trade.json"
    return json.loads(path.read_text()) if path.is_file() else None
