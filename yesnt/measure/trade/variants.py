"""The settings that are measured, stage by stage; the last one of each stage is its reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from yesnt.decompose.settings import EnsembleSettings


@dataclass(frozen=True)
class Variant:
    """One setting of one stage.

    Attributes:
        stage: decompose, flow, solve or relight.
        name: label in tables and plots.
        job: the same setting as keys of a job file, to be merged into it.
        ensemble: of decompose variants.
        knobs: of the backend, for decompose variants.
        method: of flow variants.
        tolerance: of solve variants.
        quality: of relight variants.
    """

    stage: str
    name: str
    job: dict[str, Any]
    ensemble: EnsembleSettings = field(default_factory=EnsembleSettings)
    knobs: dict[str, Any] = field(default_factory=dict)
    method: str = "dis-quality"
    tolerance: float = 1e-4
    quality: str = "standard"


STAGES = ("decompose", "flow", "solve", "relight")


def variants(steps: tuple[int, ...]) -> list[Variant]:
    """All variants; `steps` are the backend's sampling steps to try, empty to keep its default."""
    return [*_decompose(steps), *_flow(), *_solve(), *_relight()]


def _decompose(steps: tuple[int, ...]) -> list[Variant]:
    def one(name: str, step: int | None = None, **ensemble: Any) -> Variant:
        fields = {"tolerance": 0.0, "keyframe_step": 1, **ensemble}
        knobs = {} if step is None else {"steps": step}
        samples = fields.get("samples", 16)
        rest = {k: v for k, v in fields.items() if k != "samples"}
        job = {"decompose": {"samples": samples, "knobs": {**rest, **knobs}}}
        return Variant("decompose", name, job, EnsembleSettings(**{**fields, "samples": samples}), knobs)

    fewest, most = (steps[0], steps[-1]) if steps else (None, None)
    tried = [one(f"K={k}, {s} steps" if s else f"K={k}", s, samples=k) for s in steps or (None,) for k in (2, 4, 8)]
    tried += [one(f"tolerance {t}", fewest, tolerance=t) for t in (0.02, 0.05)]
    keyframes = (("every 2nd", 2), ("every 4th", 4))
    tried += [one(f"tolerance 0.05, {name}", fewest, tolerance=0.05, keyframe_step=n) for name, n in keyframes]
    tried += [one(f"K=2, {name}", fewest, samples=2, keyframe_step=n) for name, n in keyframes]
    tried += [one(f"K=2, overlap {o}", fewest, samples=2, overlap=o) for o in (0.125, 0.5)]
    return [*tried, one("K=16, overlap 0.5", most, samples=16, overlap=0.5)]


def _flow() -> list[Variant]:
    names = ("dis-fast", "dis-medium", "dis-quality", "deepflow")
    return [Variant("flow", n, {"flow": {"knobs": {"method": n}}}, method=n) for n in names]


def _solve() -> list[Variant]:
    found = (1e-2, 1e-3, 1e-4, 1e-6)
    return [Variant("solve", f"tolerance {t:g}", {"temporal": {"tolerance": t}}, tolerance=t) for t in found]


def _relight() -> list[Variant]:
    names = ("draft", "standard", "final", "reference")
    return [Variant("relight", name, {"quality": name}, quality=name) for name in names]
