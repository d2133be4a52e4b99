"""The paper's margins compared with ours, and the reason where one does not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

PAPER = MappingProxyType({
    "no_relighting": {"psnr": 22.84, "ssim_whole": 0.9265}, "no_decomposition": {"psnr": 28.57, "ssim_whole": 0.9507},
    "full": {"psnr": 30.19, "ssim_whole": 0.9580}, "blender_proxy": {"psnr": 29.42},
})  # fmt: skip
"""What the paper prints for its own data, with its own (unstated) masks; LPIPS there is not our ST-LPIPS."""

PAPER_VIDEO = MappingProxyType(
    {"unregularised": {"tpsnr": 28.87, "ppl": 0.3598}, "full": {"tpsnr": 29.37, "ppl": 0.3587}}
)


@dataclass(frozen=True)
class Margin:
    """A margin by which Full must exceed another row.

    Attributes:
        title: the claim.
        other: the row that Full is compared with; None: the value of Full itself is tested.
        metric: name of the metric.
        least: smallest difference (or value) with which the margin holds.
    """

    title: str
    other: str | None
    metric: str
    least: float


MARGINS = (
    Margin("Full over No Relighting, PSNR", "no_relighting", "psnr", 7.35),
    Margin("Full over No Decomposition, PSNR", "no_decomposition", "psnr", 1.62),
    Margin("Full over the proxy mesh in Blender, PSNR", "blender_proxy", "psnr", 0.77),
    Margin("SSIM of Full, whole frame", None, "ssim_whole", 0.958),
    Margin("SSIM of Full, inside the matte", None, "ssim", 0.958),
)  # fmt: skip


def margins(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every margin with the measured value, whether it holds, and why not."""
    rows = {row["name"]: row for row in document["rows"]}
    return [_measured(margin, rows, document) for margin in MARGINS]


def _measured(margin: Margin, rows: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    full = _paired(rows, document, margin, "full")
    found = {"title": margin.title, "least": margin.least, "measured": full, "holds": None, "why": ""}
    if full is None:
        missing = next(row for row in ("full", margin.other) if row and not rows[row]["values"])
        found["why"] = f"not measured: {rows[missing]['title']}: {rows[missing]['absent'] or 'its tasks failed'}"
        return found
    found["holds"] = full >= margin.least
    if not found["holds"]:
        found["why"] = _why(margin, full, rows, document)
    return found


def _paired(rows: Mapping[str, Any], document: Mapping[str, Any], margin: Margin, row: str) -> float | None:
    """Mean difference of the metric over the cells that both rows have; without another row, mean of the metric."""
    cells = document["cells"].get(row, {})
    if margin.other is None:
        values = [cell[margin.metric] for cell in cells.values()]
    else:
        others = document["cells"].get(margin.other, {})
        values = [cells[name][margin.metric] - others[name][margin.metric] for name in cells if name in others]
    return sum(values) / len(values) if values else None


def _why(margin: Margin, full: float, rows: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    ceiling = _paired(rows, document, margin, "full_true")
    largest = next((one for one in document["separation"] if one["largest"]), None)
    parts = []
    if ceiling is not None and ceiling < margin.least:
        parts.append(
            f"even with true materials it is {ceiling:.4g}: relighting, or the set itself, leaves no more room"
        )
    elif ceiling is not None:
        parts.append(
            f"with true materials it is {ceiling:.4g} and would hold: the decomposition costs {ceiling - full:.3g}"
        )
    if largest is not None:
        parts.append(f"largest error: {largest['stage']} (RMSE {largest['rmse']:.3f})")
    return "; ".join(parts)
