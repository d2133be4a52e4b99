"""Measures the settings one at a time against the reference, and writes the curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from yesnt.core.errors import UsageError
from yesnt.io.durable import write_bytes, write_json
from yesnt.measure.trade.choose import Point, cheapest
from yesnt.measure.trade.harness import Lab, Spent
from yesnt.measure.trade.plot import plot_svg
from yesnt.measure.trade.variants import Variant, variants
from yesnt.runtime.session import Session

Listener = Callable[[str], None]


@dataclass(frozen=True)
class TradeOptions:
    """What is asked.

    Attributes:
        frames: frames in a row, from the middle of the shot, that are tried; at least 2.
        error: largest error that is good enough.
        seconds: most processor seconds a frame.
    """

    frames: int = 6
    error: float | None = None
    seconds: float | None = None


def run_trade(session: Session, options: TradeOptions, listen: Listener = lambda line: None) -> dict[str, Any]:
    """Tries every variant; writes `trade.json` and `trade.svg` into the run folder; returns the document.

    Error is the root mean square difference, display-referred and inside the matte, between the middle frame relit with
    the variant and with the stage's reference, all other stages alike. Seconds are of this processor, one thread.

    Raises:
        UsageError: the shot reads its passes, or has too few frames.
    """
    import torch

    torch.set_num_threads(1)
    lab = Lab(session, _middle(session, options.frames))
    steps = (1, 2, 4) if session.job.shot.decompose.backend == "embedded" else ()
    points, tried = [], variants(steps)
    base = next(v for v in tried if v.stage == "decompose")
    measure = _Bench(lab, base)
    for stage in dict.fromkeys(v.stage for v in tried):
        of_stage = [v for v in tried if v.stage == stage]
        reference, cost = measure(of_stage[-1])
        points.append(_point(of_stage[-1], cost, 0.0, len(lab.frames)))
        for variant in of_stage[:-1]:
            shown, cost = measure(variant)
            error = float(np.sqrt(np.mean((shown - reference) ** 2, dtype=np.float64)))
            points.append(_point(variant, cost, error, len(lab.frames)))
            listen(f"{stage}: {variant.name}: {points[-1].seconds:.2f} s a frame, error {error:.5f}")
    choice = cheapest(points, options.error, options.seconds)
    jobs = {(v.stage, v.name): v.job for v in tried}
    document = {
        "frames": list(lab.frames),
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


class _Bench:
    """Runs a variant; what the other stages do is done once."""

    def __init__(self, lab: Lab, base: Variant) -> None:
        self._lab, self._base = lab, base
        self._observed: dict[str, Any] = {}

    def __call__(self, variant: Variant) -> tuple[np.ndarray, Spent]:
        """The middle frame under a variant, and what its stage cost for all frames."""
        lab, base = self._lab, self._base
        own = variant if variant.stage == "decompose" else base
        if own.name not in self._observed:
            self._observed = {base.name: self._observed.get(base.name)} if base.name in self._observed else {}
            self._observed[own.name] = lab.observe(own.ensemble, own.knobs, base.method)
        mean, std, drawn = self._observed[own.name]
        fused, solved = lab.fuse(mean, std, variant.method, variant.tolerance)
        shown, relit = lab.shown(fused, variant.quality)
        relit.seconds *= len(lab.frames)  # one frame was relit
        costs = {"decompose": drawn, "flow": lab.links(variant.method)[1], "solve": solved, "relight": relit}
        return shown, costs[variant.stage]


def _point(variant: Variant, cost: Spent, error: float, frames: int) -> Point:
    return Point(variant.stage, variant.name, cost.seconds / frames, error, cost.evaluations / frames)


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
    """What an earlier `yesnt trade` measured; None if there was none."""
    import json

    path = run / "trade.json"
    return json.loads(path.read_text()) if path.is_file() else None
