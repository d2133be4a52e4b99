"""The settings that are measured, stage by stage; the last one of each stage is its reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from yesnt.core.capture_input import EvidenceInput
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.settings import EnsembleSettings


@dataclass(frozen=True)
class Variant:
    """One setting of one stage.

    Attributes:
        stage: decompose, evidence, flow, solve or relight.
        name: label in tables and plots.
        job: the same setting as keys of a job file, to be merged into it.
        ensemble: of decompose variants.
        knobs: of the backend, for decompose variants.
        method: of flow variants.
        tolerance: of solve variants.
        quality: of relight variants.
        evidence: of evidence variants.
    """

    stage: str
    name: str
    job: dict[str, Any]
    ensemble: EnsembleSettings = field(default_factory=EnsembleSettings)
    knobs: dict[str, Any] = field(default_factory=dict)
    method: str = "dis-quality"
    tolerance: float = 1e-4
    quality: str = "standard"
    evidence: EvidenceInput | None = None


STAGES = ("decompose", "evidence", "flow", "solve", "relight")


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


MOST_CAMERAS = 16
"""Cameras of the reference, if there are so many."""


def evidence_variants(cameras: int, finest: int, shot: EvidenceInput) -> list[Variant]:
    """Variants of the evidence of a shot with a capture.

    Args:
        cameras: how many see the subject.
        finest: least step from one measured frame to the next for which there are pictures.
        shot: the section of the job, whose other settings are kept.
    """
    usual = EvidenceSettings(**shot.knobs)  # type: ignore[arg-type]
    most = min(cameras, MOST_CAMERAS)

    def one(name: str, cameras: int = most, every: int = finest, **knobs: int | float) -> Variant:
        document = {"cameras": cameras, "every": every, "knobs": {**shot.knobs, **knobs}}
        asked = EvidenceInput.model_validate({"use": True, **document})
        job = {name: value for name, value in document.items() if value != {}}
        return Variant("evidence", name, {"evidence": job}, evidence=asked)

    counts = dict.fromkeys(n for n in (1, 2, 4, 8, 12, MOST_CAMERAS, most) if n <= most)
    tried = [one(f"{n} camera{'s' * (n > 1)}", n) for n in counts]
    tried += [one(f"every {_ordinal(n * finest)}", every=n * finest) for n in (2, 4)]
    pixels = {4: "1 pixel of 16", 2: "1 pixel of 4", 1: "every pixel"}
    tried += [one(f"{name} fitted", step=step) for step, name in pixels.items() if step != usual.step]
    tried += [one(f"grid {r} x {m}", roughness_levels=r, metallic_levels=m) for r, m in ((5, 3), (15, 9))]
    widths = {radius: f"pooled over {2 * radius + 1} x {2 * radius + 1}" for radius in (2, 5, 20)}
    tried += [one(name, radius=r, window=r / 2) for r, name in widths.items() if r != usual.radius]
    return [*tried, one("every pixel, grid 15 x 9", step=1, roughness_levels=15, metallic_levels=9)]


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number // 10 % 10 != 1 else "th"
    return f"{number}{ending}"


def _flow() -> list[Variant]:
    names = ("dis-fast", "dis-medium", "dis-quality", "deepflow")
    return [Variant("flow", n, {"flow": {"knobs": {"method": n}}}, method=n) for n in names]


def _solve() -> list[Variant]:
    found = (1e-2, 1e-3, 1e-4, 1e-6)
    return [Variant("solve", f"tolerance {t:g}", {"temporal": {"tolerance": t}}, tolerance=t) for t in found]


def _relight() -> list[Variant]:
    names = ("draft", "standard", "final", "reference")
    return [Variant("relight", name, {"quality": name}, quality=name) for name in names]
