"""The self-contained HTML page of an evaluation: tables with their definitions, pictures beside numbers."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.io.durable import write_bytes
from yesnt.io.templates import render
from yesnt.measure.evaluation.evidence_rows import EVIDENCE_ROWS
from yesnt.measure.evaluation.pictures import MATERIAL_PANELS, PANELS
from yesnt.measure.evaluation.sequence_tasks import MATERIAL_STRIP, PLANES
from yesnt.measure.evaluation.table import headline, number, tables, title
from yesnt.metrics.definitions import DEFINITIONS

_BESIDE = ("psnr", "psnr_aligned", "ssim", "flip", "hdr_flip", "stlpips")
"""Metrics that are printed beside a picture."""

_LONG = 60
"""Cells with more characters than this are wrapped and aligned to the left."""


@dataclass(frozen=True)
class Number:
    """One line of the table beside a picture."""

    name: str
    definition: str
    text: str


@dataclass(frozen=True)
class Figure:
    """A picture and the numbers beside it.

    Attributes:
        name: heading, escaped by the template.
        jpeg: the picture in Base64.
        numbers: lines of the table beside it.
        remark: text after the heading.
    """

    name: str
    jpeg: str
    numbers: tuple[Number, ...]
    remark: str = ""


@dataclass(frozen=True)
class Sparsification:
    """The curves of one material plane of one shot, as points of an SVG polyline.

    Attributes:
        shot: name of the shot.
        plane: "roughness" or "metallic".
        top: RMSE at the top of the drawing.
        lines: colour and points of each curve.
    """

    shot: str
    plane: str
    top: float
    lines: tuple[dict[str, str], ...]


def write_page(path: Path, document: Mapping[str, Any], output: Path) -> None:
    """Writes the page of an evaluation.

    Args:
        path: of the HTML file.
        document: what `summarise` made.
        output: the evaluation's folder, which holds the pictures; a picture that is absent is left out.
    """
    page = render(
        "evaluation.html.jinja",
        title=title(document),
        headline=headline(document),
        tables=tables(document),
        cell_class=_cell_class,
        calibration=_calibration(document),
        panels=PANELS,
        figures=[figure for one in document["worst"] if (figure := _figure(one, document, output))],
        fitted=[figure for one in document.get("fitted", ()) if (figure := _figure(one, document, output))],
        material_panels=MATERIAL_PANELS,
        materials=list(_material_figures(document, output)),
    )
    write_bytes(path, page.encode())


def _cell_class(text: str) -> str:
    return {"holds": "good", "does not hold": "bad"}.get(text, "text" if len(text) > _LONG else "")


def _figure(one: Mapping[str, Any], document: Mapping[str, Any], output: Path) -> Figure | None:
    picture = output / one["picture"]
    if not picture.is_file():
        return None
    values = document["cells"][one["row"]][one["cell"]]
    numbers = tuple(
        Number(name, document["definitions"][name], number(name, values[name])) for name in _BESIDE if name in values
    )
    return Figure(one["cell"], _base64(picture), numbers, _remark(one["row"]))


def _remark(row: str) -> str:
    """What a picture shows that is not Full."""
    if row in EVIDENCE_ROWS:
        return f" ({EVIDENCE_ROWS[row].title})"
    return " (true materials)" if row == "full_true" else ""


def _material_figures(document: Mapping[str, Any], output: Path) -> Iterable[Figure]:
    """True and estimated materials of every shot, largest error first."""
    shots = document["material"]["shots"]
    for shot in sorted(shots, key=lambda name: -sum(shots[name]["material"][p]["own"]["rmse"] for p in PLANES)):
        path = output / "shots" / shot / "out" / "pictures" / MATERIAL_STRIP
        if not path.is_file():
            continue
        own = {plane: shots[shot]["material"][plane]["own"] for plane in PLANES}
        numbers = (
            Number(f"{plane} {metric}", DEFINITIONS[metric].text, number(metric, own[plane][metric]))
            for plane in PLANES
            for metric in ("rmse", "bias")
        )
        yield Figure(shot, _base64(path), tuple(numbers))


def _calibration(document: Mapping[str, Any]) -> list[Sparsification]:
    """RMSE of the remaining pixels against their share, of every shot and plane."""
    return [
        _curves(shot, plane, curves)
        for shot, found in document["material"]["shots"].items()
        for plane, curves in found["sparsification"].items()
    ]


def _curves(shot: str, plane: str, curves: Mapping[str, list[float]]) -> Sparsification:
    top = max(max(curve) for curve in curves.values()) or 1.0
    lines = tuple(
        {
            "color": color,
            "points": " ".join(f"{20 + 15 * i},{120 - 100 * v / top:.1f}" for i, v in enumerate(curves[name])),
        }
        for name, color in (("oracle", "#999"), ("spread", "#1f5fbf"))
    )
    return Sparsification(shot, plane, top, lines)


def _base64(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
