"""Effects that relighting does not model, and their share of the error: further bounces, and variants of a subject."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from yesnt.core.color import srgb_encode
from yesnt.core.stage_id import StageId
from yesnt.measure.evaluation.plan import EvalPlan
from yesnt.metrics.image import mean_squared_error

VARIANT = "+"
"""Separates subject and effect in the name of a shot: `bust+hair` is `bust` with hair."""

Cells = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Row -> "shot / map" -> metric -> value."""


def unmodelled_effects(plans: Sequence[EvalPlan], cells: Cells) -> list[dict[str, Any]]:
    """One line per effect: RMSE of the effect itself, and of ours against truths with and without it."""
    lines = list(_bounce_lines(plans))
    names = {plan.subject.name: plan for plan in plans}
    effects = sorted({name.split(VARIANT)[1] for name in names if VARIANT in name})
    return lines + [line for effect in effects if (line := _variant_line(effect, names, cells))]


def _bounce_lines(plans: Sequence[EvalPlan]) -> Iterator[dict[str, Any]]:
    facts = [
        record.facts["bounces"]
        for plan in plans
        for name, _ in plan.subject.maps
        if (record := plan.session.book.find(StageId("bounces", part=name), plan.page_frame(name))) is not None
    ]
    for number in sorted({int(n) for one in facts for n in one}):
        mean = {k: float(np.mean([one[str(number)][k] for one in facts if str(number) in one])) for k in _KINDS}
        yield {
            "effect": f"light after bounce {number}", "definition": "Cycles with paths cut there against all of them; "
            "ours with as many bounces and true materials, against all of them and against the cut ones",
            "rmse": _root(mean["effect"]), "with": _root(mean["ours"]), "without": _root(mean["ours_alike"]),
            "share": mean["effect"] / mean["ours"] if mean["ours"] else None, "n": len(facts),
        }  # fmt: skip


_KINDS = ("effect", "ours", "ours_alike")


def _variant_line(effect: str, plans: Mapping[str, EvalPlan], cells: Cells) -> dict[str, Any] | None:
    scored = cells.get("full_true", {})
    pairs = [
        (plan, plans[base], name)
        for shot, plan in plans.items()
        if (base := shot.partition(VARIANT)[0]) in plans and shot.endswith(VARIANT + effect)
        for name, _ in plan.subject.maps
        if f"{shot} / {name}" in scored and f"{base} / {name}" in scored
    ]
    if not pairs:
        return None
    errors = np.mean([[_difference(a, b, n), *(_error(scored, p, n) for p in (a, b))] for a, b, n in pairs], axis=0)
    return {
        "effect": effect, "definition": "Cycles with the effect against without it, inside both mattes; ours with true "
        "materials where the truth has the effect, and where it has not",
        "rmse": _root(errors[0]), "with": _root(errors[1]), "without": _root(errors[2]),
        "share": float((errors[1] - errors[2]) / errors[1]), "n": len(pairs),
    }  # fmt: skip


def _difference(one: EvalPlan, other: EvalPlan, name: str) -> float:
    """Mean squared display difference of two truths inside both mattes."""
    (a, a_cover), (b, b_cover) = (plan.subject.read_relit(name, plan.page_frame(name)) for plan in (one, other))
    return mean_squared_error(srgb_encode(a), srgb_encode(b), np.minimum(a_cover, b_cover) > 0.99)


def _error(scored: Mapping[str, Mapping[str, float]], plan: EvalPlan, name: str) -> float:
    return float(10 ** (-scored[f"{plan.subject.name} / {name}"]["psnr"] / 10))


def _root(value: float) -> float:
    return float(np.sqrt(value))
