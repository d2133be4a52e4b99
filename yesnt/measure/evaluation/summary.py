"""Collects the records of an evaluation in one document: rows, errors of each stage, margins, worst cases."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from yesnt.core.stage_id import StageId
from yesnt.measure.evaluation.evidence_rows import EVIDENCE_ROWS, shown_row
from yesnt.measure.evaluation.fitted_rows import FITTED_ROWS, STRIP_ROW
from yesnt.measure.evaluation.margins import margins
from yesnt.measure.evaluation.pictures import strip_name
from yesnt.measure.evaluation.plan import MEASURED_MATERIAL, EvalPlan
from yesnt.measure.evaluation.rows import ROWS, SEPARATIONS, Row
from yesnt.measure.evaluation.unmodelled import unmodelled_effects
from yesnt.metrics.definitions import DEFINITIONS
from yesnt.metrics.image import decibels

_VIDEO_ROWS = ("unregularised", "full", "truth")
_SCORES = ("independent", "reference", "score", "ablation", "constant", "measured")
"""Stages whose records hold scores of rows; "fitted" too where a field was fitted."""

Cells = dict[str, dict[str, dict[str, float]]]
"""Row -> "shot / map" -> metric -> value."""


def summarise(plans: Sequence[EvalPlan], constants: Mapping[str, Mapping[str, tuple[float, float]]]) -> dict[str, Any]:
    """The document behind Markdown and page; plain JSON data, None where a number is infinite or absent."""
    cells = _cells(plans)
    document = {
        "shots": [_shot(plan) for plan in plans],
        "constants": {shot: {row: list(pair) for row, pair in rows.items()} for shot, rows in constants.items()},
        "rows": [_row(row, plans, cells) for row in _shown_rows(plans)],
        "cells": cells,
        "separation": _separation(plans),
        "material": _material(plans),
        "measured": _measured(plans),
        "geometry": _geometry(plans),
        "geometry_parts": _geometry_parts(plans),
        "video": _video(plans),
        "worst": _worst(plans, cells),
        "fitted": _fitted_strips(plans, cells),
        "definitions": {name: definition.text for name, definition in DEFINITIONS.items()},
    }
    document["margins"] = margins(document)
    document["unmodelled"] = unmodelled_effects(plans, cells)
    return _finite(document)


def spread(values: Iterable[float | None]) -> dict[str, float]:
    """Mean and population standard deviation of the finite values, and how many they are."""
    known = [v for v in values if v is not None and math.isfinite(v)]
    if not known:
        return {"n": 0}
    return {"mean": float(np.mean(known)), "std": float(np.std(known)), "n": len(known)}


def _cells(plans: Sequence[EvalPlan]) -> Cells:
    """Mean over the scored frames of every metric of every row, shot and map."""
    cells: Cells = {}
    for plan in plans:
        for name, _ in plan.subject.maps:
            rows: dict[str, list[Mapping[str, float]]] = {}
            stages = _SCORES if plan.fitted is None else (*_SCORES, "fitted", "fitted_reference")
            for facts in _facts(plan, name, stages):
                for row, numbers in facts["rows"].items():
                    rows.setdefault(row, []).extend([numbers] if numbers else [])
            for row, frames in rows.items():
                if frames:
                    cells.setdefault(row, {})[_cell(plan, name)] = _mean(frames)
    return cells


def _facts(plan: EvalPlan, name: str, stages: Iterable[str]) -> Iterable[Mapping[str, Any]]:
    for stage in stages:
        for frame in plan.scored_frames(name):
            record = plan.session.book.find(StageId(stage, part=name), frame)
            if record is not None:
                yield record.facts


def _mean(frames: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {metric: float(np.mean([frame[metric] for frame in frames])) for metric in frames[0]}


def _shot(plan: EvalPlan) -> dict[str, Any]:
    job, backend = plan.session.job, plan.session.resolved.backend
    return {
        "name": plan.subject.name, "width": job.width, "height": job.height, "frames": len(job.frames),
        "maps": {name: list(plan.scored_frames(name)) for name, _ in plan.subject.maps}, "quality": job.shot.quality,
        "lacking": plan.lacking,
        "backend": None if plan.lacking or backend is None else backend.name,
        "weights": None if plan.lacking or backend is None else backend.weights,
    }  # fmt: skip


def _shown_rows(plans: Sequence[EvalPlan]) -> list[Row]:
    """Rows of the tables; those of a capture only if a shot has one."""
    measured = {name for plan in plans for name in plan.measured}
    rows = [row for row in ROWS.values() if row.group != "separation"]
    rows += [row for row in EVIDENCE_ROWS.values() if row.name in measured]
    return rows + (list(FITTED_ROWS.values()) if any(plan.fitted is not None for plan in plans) else [])


def _measured(plans: Sequence[EvalPlan]) -> dict[str, Any]:
    """Errors of the materials that a capture measured, by row and plane: over the shots, and of each shot."""
    shots: dict[str, Any] = {}
    for plan in plans:
        record = plan.session.book.find(MEASURED_MATERIAL, plan.frames[0])
        if record is not None and plan.measured:
            shots[plan.subject.name] = record.facts["measured"]
    rows = dict.fromkeys(row for found in shots.values() for row in found)
    mean = {
        row: {
            plane: _spreads([found[row][plane] for found in shots.values() if row in found])
            for plane in ("roughness", "metallic")
        }
        for row in rows
    }
    return {"mean": mean, "shots": shots}


def _geometry(plans: Sequence[EvalPlan]) -> dict[str, Any]:
    """Errors of the fitted geometry of each shot: means over its scored frames."""
    found: dict[str, Any] = {}
    for plan in plans:
        frames = [facts["geometry"] for name, _ in plan.subject.maps for facts in _facts(plan, name, ("fitted",))]
        if frames and plan.fitted is not None:
            found[plan.subject.name] = _mean(frames)
    return found


def _geometry_parts(plans: Sequence[EvalPlan]) -> dict[str, Any]:
    """True materials on the given inputs, and with one part of the fitted geometry each: metrics over the pairs."""
    pairs: list[dict[str, Any]] = []
    for plan in plans if any(plan.fitted is not None for plan in plans) else ():
        for name in plan.probe_maps:
            frames = [facts["parts"] for facts in _facts(plan, name, ("fitted",)) if facts.get("parts")]
            pairs += [{part: _mean([frame[part] for frame in frames]) for part in frames[0]}] if frames else []
    return {part: _spreads([pair[part] for pair in pairs]) for part in (pairs[0] if pairs else ())}


def _row(row: Row, plans: Sequence[EvalPlan], cells: Cells) -> dict[str, Any]:
    numbers = cells.get(row.name, {})
    metrics = dict.fromkeys(metric for cell in numbers.values() for metric in cell)
    reasons = {plan.absent(name).get(row.name, "") for plan in plans for name, _ in plan.subject.maps} - {""}
    return {
        "name": row.name, "title": row.title, "group": row.group, "definition": row.definition,
        "values": {metric: spread(cell.get(metric) for cell in numbers.values()) for metric in metrics},
        "absent": "; ".join(sorted(reasons)) if not numbers else "",
        "partly": "; ".join(sorted(reasons)) if numbers else "",
    }  # fmt: skip


def _separation(plans: Sequence[EvalPlan]) -> list[dict[str, Any]]:
    """Error of each stage on its own over object x map, the largest marked."""
    found: list[dict[str, Any]] = []
    largest, worst = -1, 0.0
    for i, one in enumerate(SEPARATIONS):
        errors = _own_errors(plans, one.stage)
        rmse = math.sqrt(np.mean(errors)) if errors else None
        found.append({
            "stage": one.stage, "definition": one.text, "psnr": spread(decibels(error) for error in errors),
            "rmse": rmse, "n": len(errors), "largest": False,
        })  # fmt: skip
        if rmse is not None and rmse > worst:
            largest, worst = i, rmse
    if largest >= 0:
        found[largest]["largest"] = True
    return found


def _own_errors(plans: Sequence[EvalPlan], stage: str) -> list[float]:
    """Mean squared display error of one stage, for every shot and map that has it."""
    errors = []
    for plan in plans:
        for name, _ in plan.subject.maps:
            parts = [facts["separation"] for facts in _facts(plan, name, ("independent", "score"))]
            frames = [part[stage] for part in parts if stage in part]
            errors += [float(np.mean(frames))] if frames else []
    return errors


def _material(plans: Sequence[EvalPlan]) -> dict[str, Any]:
    """Errors of materials and flow by shot, and over all shots."""
    shots: dict[str, Any] = {}
    for plan in plans:
        record = plan.session.book.find("material", plan.frames[0])
        if record is not None:
            shots[plan.subject.name] = {
                k: record.facts[k] for k in ("material", "flow", "sparsification") if k in record.facts
            }
    planes = {
        plane: {
            source: _spreads([s["material"][plane][source] for s in shots.values()]) for source in ("observed", "own")
        }
        for plane in ("roughness", "metallic")
    }
    return {"shots": shots, "mean": planes, "flow": _spreads([s["flow"] for s in shots.values() if "flow" in s])}


def _video(plans: Sequence[EvalPlan]) -> dict[str, Any]:
    """Metrics of videos by "shot / map", and over all of them."""
    videos: dict[str, Any] = {}
    for plan in plans:
        stages = ("video", "measured_video") if plan.measured else ("video",)
        for name, _ in plan.subject.maps:
            for stage in stages:
                record = plan.session.book.find(StageId(stage, part=name), plan.frames[0])
                if record is not None and plan.has_video(name):
                    videos.setdefault(_cell(plan, name), {}).update(record.facts["video"])
    rows = dict.fromkeys((*_VIDEO_ROWS, *(row for video in videos.values() for row in video)))
    found = {row: [video[row] for video in videos.values() if row in video] for row in rows}
    return {"videos": videos, "mean": {row: _spreads(columns) for row, columns in found.items()}}


def _spreads(columns: Sequence[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    metrics = dict.fromkeys(metric for column in columns for metric in column)
    return {metric: spread(column.get(metric) for column in columns) for metric in metrics}


def _worst(plans: Sequence[EvalPlan], cells: Cells) -> list[dict[str, Any]]:
    """Every shot and map with its strips, lowest PSNR first: of Full, or of Full with true materials if that is all.

    A shot with a capture is sorted by what its cameras make of it; the strip of Full follows.
    """
    shown = "full" if cells.get("full") else "full_true"
    found = []
    for plan in plans:
        rows = (shown_row(plan.measured), shown) if plan.measured else (shown,)
        for name, _ in plan.subject.maps:
            strips = [_strip(plan, name, row, cells) for row in rows if _cell(plan, name) in cells.get(row, {})]
            found += [strips] if strips else []
    return [strip for strips in sorted(found, key=lambda strips: strips[0]["psnr"]) for strip in strips]


def _strip(plan: EvalPlan, name: str, row: str, cells: Cells) -> dict[str, Any]:
    picture = f"shots/{plan.subject.name}/out/pictures/{strip_name(name, plan.page_frame(name), row)}"
    cell = _cell(plan, name)
    return {"cell": cell, "row": row, "picture": picture, "psnr": cells[row][cell]["psnr"]}


def _cell(plan: EvalPlan, name: str) -> str:
    """Name of a shot under a map, as `cells` has it."""
    return f"{plan.subject.name} / {name}"


def _fitted_strips(plans: Sequence[EvalPlan], cells: Cells) -> list[dict[str, Any]]:
    """Every shot and map whose geometry is fitted with its strip, lowest PSNR first."""
    found = []
    for plan in plans:
        for name, _ in plan.subject.maps:
            if plan.fitted is not None and _cell(plan, name) in cells.get(STRIP_ROW, {}):
                found.append(_strip(plan, name, STRIP_ROW, cells))
    return sorted(found, key=lambda one: one["psnr"])


def _finite(value: Any) -> Any:
    """The same document with None for infinities and NaN, which JSON cannot hold."""
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
