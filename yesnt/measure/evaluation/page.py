"""One self-contained page: tables with their definitions, pictures beside numbers, worst cases first."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from yesnt.io.durable import write_bytes
from yesnt.measure.evaluation.pictures import MATERIAL_PANELS, PANELS
from yesnt.measure.evaluation.sequence_tasks import MATERIAL_STRIP, PLANES
from yesnt.measure.evaluation.table import Table, headline, number, tables, title

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:78rem;padding:0 1rem;color:#1b1b1b;background:#fff}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
th,td{padding:.25rem .6rem;text-align:right;white-space:nowrap;border-bottom:1px solid #ddd}
th:first-child,td:first-child{text-align:left;position:sticky;left:0;background:#fff}
td.text{text-align:left;white-space:normal;min-width:22rem}
details{margin:.4rem 0 1.6rem;color:#444}figure{margin:1.2rem 0;display:grid;grid-template-columns:1fr 17rem;gap:1rem}
figure img{width:100%;background:#000}.bad{color:#a4161a;font-weight:600}.good{color:#1d6b2f}svg{max-width:26rem}
"""

_BESIDE = ("psnr", "psnr_aligned", "ssim", "flip", "hdr_flip", "stlpips")
"""Numbers that stand beside a picture."""


def write_page(path: Path, document: Mapping[str, Any], output: Path) -> None:
    """Writes the page; pictures come from the evaluation's folder."""
    parts = [f"<h1>Evaluation of {escape(title(document))}</h1><p>{escape(headline(document))}</p>"]
    parts += [_table(table) for table in tables(document)]
    parts += [
        _calibration(document),
        "<h2>Pictures, worst first</h2>",
        f"<p>From left to right: {', '.join(PANELS)}.</p>",
    ]
    parts += [_figure(one, document, output) for one in document["worst"]]
    parts += _materials(document, output)
    head = f"<!doctype html><meta charset=utf-8><title>yesnt eval</title><style>{_STYLE}</style>"
    write_bytes(path, (head + "\n".join(parts)).encode())


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.header)
    body = "".join("<tr>" + "".join(_cell(cell) for cell in line) + "</tr>" for line in table.lines)
    notes = "".join(f"<li>{escape(note)}</li>" for note in table.notes)
    return (
        f"<h2>{escape(table.title)}</h2><table><tr>{head}</tr>{body}</table>"
        f"<details open><summary>Definitions</summary><ul>{notes}</ul></details>"
    )


def _cell(text: str) -> str:
    kind = {"holds": "good", "does not hold": "bad"}.get(text, "text" if len(text) > 60 else "")
    return f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"


def _figure(one: Mapping[str, Any], document: Mapping[str, Any], output: Path) -> str:
    picture = output / one["picture"]
    if not picture.is_file():
        return ""
    numbers = document["cells"][one["row"]][one["cell"]]
    lines = "".join(
        f'<tr title="{escape(document["definitions"][m])}"><td>{escape(m)}</td><td>{number(m, numbers[m])}</td></tr>'
        for m in _BESIDE
        if m in numbers
    )
    note = " (true materials)" if one["row"] == "full_true" else ""
    image = _image(picture, one["cell"])
    return f"<figure>{image}<div><b>{escape(one['cell'])}</b>{note}<table>{lines}</table></div></figure>"


def _materials(document: Mapping[str, Any], output: Path) -> list[str]:
    """A strip of true and estimated materials for every shot."""
    strips = {shot: output / "shots" / shot / "out" / "pictures" / MATERIAL_STRIP for shot in _by_error(document)}
    figures = [_plain_figure(shot, path, document) for shot, path in strips.items() if path.is_file()]
    head = f"<h2>Materials, worst first</h2><p>From left to right: {', '.join(MATERIAL_PANELS)} (0.5 is white).</p>"
    return [head, *figures] if figures else []


def _by_error(document: Mapping[str, Any]) -> list[str]:
    shots = document["material"]["shots"]
    return sorted(shots, key=lambda shot: -sum(shots[shot]["material"][p]["own"]["rmse"] for p in PLANES))


def _plain_figure(shot: str, path: Path, document: Mapping[str, Any]) -> str:
    numbers = document["material"]["shots"][shot]["material"]
    lines = "".join(
        f"<tr><td>{plane} {metric}</td><td>{number(metric, numbers[plane]['own'][metric])}</td></tr>"
        for plane in PLANES
        for metric in ("rmse", "bias")
    )
    return f"<figure>{_image(path, shot)}<div><b>{escape(shot)}</b><table>{lines}</table></div></figure>"


def _image(path: Path, title: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(title)}" src="data:image/jpeg;base64,{data}">'


def _calibration(document: Mapping[str, Any]) -> str:
    """Sparsification curves of every shot, drawn: RMSE of the pixels that are left against their share."""
    drawn = []
    for shot, found in document["material"]["shots"].items():
        for plane, curves in found["sparsification"].items():
            drawn.append(f"<td>{escape(shot)}, {plane}<br>{_curves(curves)}</td>")
    if not drawn:
        return ""
    rows = "".join(f"<tr>{''.join(drawn[i : i + 2])}</tr>" for i in range(0, len(drawn), 2))
    return (
        "<h2>Sparsification</h2><p>RMSE of the pixels that are left when those of largest standard deviation (blue) or "
        "of largest error (grey: the best possible order) are taken away; left: all pixels, right: 5 % of them.</p>"
        f"<table>{rows}</table>"
    )


def _curves(curves: Mapping[str, list[float]]) -> str:
    top = max(max(curve) for curve in curves.values()) or 1.0
    lines = ""
    for name, color in (("oracle", "#999"), ("spread", "#1f5fbf")):
        points = " ".join(f"{20 + 15 * i},{120 - 100 * v / top:.1f}" for i, v in enumerate(curves[name]))
        lines += f'<polyline fill="none" stroke="{color}" stroke-width="2" points="{points}"/>'
    axes = '<path d="M20 15V120H310" fill="none" stroke="#333"/>'
    return f'<svg viewBox="0 0 320 135">{axes}{lines}<text x="24" y="14" font-size="11">{top:.3f}</text></svg>'
