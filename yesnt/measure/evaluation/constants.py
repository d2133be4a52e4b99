"""The best constant material: the row No Decomposition uses it, so that it is as strong as it can be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from yesnt.core.stage_id import StageId
from yesnt.measure.evaluation.plan import EvalPlan

Pair = tuple[float, float]


def best_constants(plans: Sequence[EvalPlan]) -> dict[str, dict[str, Pair]]:
    """The (roughness, metallic) with the largest mean PSNR, by shot and row: over the whole set, and over one shot."""
    found = {plan.subject.name: _candidates(plan) for plan in plans}
    whole = _best([column for columns in found.values() for column in columns])
    return {
        name: {"no_decomposition": whole, "no_decomposition_each": _best(columns)} for name, columns in found.items()
    }


def _candidates(plan: EvalPlan) -> list[Mapping[str, float]]:
    """PSNR by candidate, for every map whose search is done."""
    columns = []
    for name, _ in plan.subject.maps:
        scored = plan.scored_frames(name)
        record = plan.session.book.find(StageId("search", part=name), scored[len(scored) // 2])
        if record is not None:
            columns.append(record.facts["psnr"])
    return columns


def _best(columns: Sequence[Mapping[str, float]]) -> Pair:
    """The candidate with the largest mean; the middle of the range if no search is done."""
    if not columns:
        return (0.5, 0.0)
    means = {candidate: float(np.mean([column[candidate] for column in columns])) for candidate in columns[0]}
    roughness, metallic = max(means, key=lambda candidate: means[candidate]).split(",")
    return float(roughness), float(metallic)
