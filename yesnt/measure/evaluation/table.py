"""The document as tables: the same cells for Markdown, terminal and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from yesnt.measure.evaluation.evidence_rows import EVIDENCE_ROWS
from yesnt.measure.evaluation.fitted_rows import COUNTERPARTS
from yesnt.measure.evaluation.margins import PAPER, PAPER_VIDEO
from yesnt.measure.evaluation.scene import PARTS
from yesnt.metrics.definitions import DEFINITIONS

MAIN = (
    "psnr", "psnr_whole", "ssim", "ssim_whole", "flip", "flip_whole", "hdr_flip", "stlpips", "stlpips_matte", "lpips",
    "lpips_matte",
)  # fmt: skip
ALIGNED = (
    "psnr_linear", "psnr_linear_aligned", "psnr_aligned", "ssim_aligned", "flip_aligned", "stlpips_aligned",
    "lpips_aligned",
)  # fmt: skip
QUICK = ("psnr", "psnr_aligned", "psnr_linear", "ssim", "ssim_whole", "flip")
VIDEO = ("psnr_frames", "tpsnr_diff", "tpsnr_warp", "ppl", "tlp")
MATERIAL = ("rmse", "bias", "constant_rmse", "auc", "spearman", "ause")
FLOW = ("epe", "occlusion_precision", "occlusion_recall")


@dataclass(frozen=True)
class Table:
    """Texts of a table, and the definitions of its columns and rows.

    Attributes:
        title: heading.
        header: column titles.
        lines: rows of texts.
        notes: definitions, one per line.
    """

    title: str
    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]


def tables(document: Mapping[str, Any]) -> tuple[Table, ...]:
    """Every table of the document, the main one first."""
    return tuple(
        table
        for table in (
            _rows(document, "table", "Accuracy, mean ± std over object x map", MAIN),
            _measured(document),
            _fitted(document),
            _fitted_parts(document),
            _margins(document),
            _separation(document),
            _rows(
                document, "table", "Accuracy in linear light, and with each channel scaled to the truth", ALIGNED, False
            ),
            _rows(document, "ablation", "Relighting term by term, mean ± std over object x map", QUICK),
            _video(document),
            _materials(document),
            _flow(document),
            _unmodelled(document),
            _scaling(document),
        )
        if table.lines
    )


def as_markdown(document: Mapping[str, Any]) -> str:
    """All tables and their definitions as Markdown."""
    parts = [f"# Evaluation of {title(document)}", headline(document)]
    for table in tables(document):
        parts.append(f"## {table.title}")
        lines = [table.header, tuple("---" for _ in table.header), *table.lines]
        parts.append("\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines))
        parts.append("\n".join(f"- {note}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def title(document: Mapping[str, Any]) -> str:
    """Name of the set: the last part of the folder's path."""
    return Path(document.get("folder", "a set")).name


def headline(document: Mapping[str, Any]) -> str:
    """A few sentences: what was measured, and which stage has the largest error."""
    shots = document["shots"]
    cells = sum(len(shot["maps"]) for shot in shots)
    sizes = sorted({f"{shot['width']}x{shot['height']}" for shot in shots})
    parts = [f"{len(shots)} shots, {cells} pairs of object and map, {', '.join(sizes)}, quality {shots[0]['quality']}."]
    weights = sorted({shot["weights"][:12] for shot in shots if shot.get("weights")})
    if document.get("date"):
        parts.append(f"Measured {document['date']}" + (f", weights {', '.join(weights)}." if weights else "."))
    largest = next((one for one in document["separation"] if one["largest"]), None)
    if largest:
        parts.append(
            f"Largest error: {largest['stage']} (display RMSE {largest['rmse']:.4f}; {largest['definition']})."
        )
    lacking = sorted({shot["lacking"] for shot in shots if shot["lacking"]})
    return " ".join([*parts, *(f"Not measured: {reason}." for reason in lacking)])


def number(metric: str, value: Mapping[str, float] | float | None) -> str:
    """`30.19 ± 2.40`, or `-` where there is none."""
    digits = DEFINITIONS[metric].digits
    if isinstance(value, Mapping):
        return f"{value['mean']:.{digits}f} ± {value['std']:.{digits}f}" if value.get("n") else "-"
    return "-" if value is None else f"{value:.{digits}f}"


def _titles(metrics: Sequence[str]) -> tuple[str, ...]:
    arrows = {"higher": " ↑", "lower": " ↓", "zero": " →0", "neither": ""}
    return tuple(DEFINITIONS[m].title + arrows[DEFINITIONS[m].better] for m in metrics)


def _notes(metrics: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{DEFINITIONS[m].title} [{DEFINITIONS[m].unit}]: {DEFINITIONS[m].text}" for m in metrics)


def _rows(document: Mapping[str, Any], group: str, title: str, wanted: Sequence[str], explained: bool = True) -> Table:
    """Table of a group of rows. `explained`: with every row's definition, and why a row could not be measured."""
    rows = [row for row in document["rows"] if row["group"] == group]
    metrics = [m for m in wanted if any(row["values"].get(m, {}).get("n") for row in rows)]
    lines, notes = [], []
    for row in rows:
        cells = [number(m, row["values"].get(m)) for m in metrics]
        pairs = max((value.get("n", 0) for value in row["values"].values()), default=0)
        lines.append((row["title"], *_paper(group, row["name"]), str(pairs), *cells))
        reason = row["absent"] or row["partly"]
        notes.append(f"{row['title']}: {row['definition']}" + (f". Not measured ({reason})" if reason else ""))
    if group == "table":
        notes += _constants(document)
    paper = ("paper: PSNR / SSIM",) if group == "table" else ()
    known = tuple(notes) if explained else ()
    return Table(title, ("row", *paper, "pairs", *_titles(metrics)), tuple(lines), (*known, *_notes(metrics)))


def _paper(group: str, name: str) -> tuple[str, ...]:
    if group != "table":
        return ()
    return (" / ".join(f"{value}" for value in PAPER.get(name, {}).values()) or "-",)


def _constants(document: Mapping[str, Any]) -> list[str]:
    texts = []
    for shot, rows in document["constants"].items():
        pair = rows["no_decomposition_each"]
        texts.append(f"{shot} {pair[0]:g}, {pair[1]:g}")
    whole = next(iter(document["constants"].values()))["no_decomposition"]
    return [
        f"Best constant of the set: roughness {whole[0]:g}, metallic {whole[1]:g}; per shot: {'; '.join(texts)} "
        "(grid search with few directions at one pixel in 25, under a few maps of each shot)"
    ]


def _margins(document: Mapping[str, Any]) -> Table:
    words = {True: "holds", False: "does not hold", None: "not measured"}
    lines = [
        (
            m["title"],
            f"{m['least']:g}",
            "-" if m["measured"] is None else f"{m['measured']:.4g}",
            words[m["holds"]],
            m["why"],
        )
        for m in document["margins"]
    ]
    note = "A margin is the mean difference over the pairs of object and map that both rows have."
    return Table("The paper's margins", ("margin", "at least", "measured", "", "why"), tuple(lines), (note,))


def _separation(document: Mapping[str, Any]) -> Table:
    lines = [
        (
            one["stage"] + (" (largest)" if one["largest"] else ""),
            number("psnr", one["psnr"]),
            f"{one['rmse']:.4f}",
            str(one["n"]),
        )
        for one in document["separation"]
        if one["rmse"] is not None
    ]
    notes = tuple(f"{one['stage']}: {one['definition']}" for one in document["separation"])
    head = ("stage alone, truth in all others", "PSNR ↑", "RMSE ↓", "pairs")
    return Table(
        "Each stage's own error", head, tuple(lines), (*notes, "PSNR and RMSE of display values inside the matte")
    )


def _video(document: Mapping[str, Any]) -> Table:
    mean = document["video"]["mean"]
    measured = {name: row.title for name, row in EVIDENCE_ROWS.items() if name in mean}
    titles = {"unregularised": "without temporal regularisation", "full": "Full"} | measured
    titles["truth"] = "the truth itself"
    metrics = [m for m in VIDEO if any(m in mean[row] for row in titles)]
    lines = [
        (
            title,
            " / ".join(f"{v}" for v in PAPER_VIDEO.get(row, {}).values()) or "-",
            *(number(m, mean[row].get(m)) for m in metrics),
        )
        for row, title in titles.items()
        if mean[row]
    ]
    note = "The paper defines neither its tPSNR nor the network of its PPL: its column is not comparable in value"
    return Table("Videos", ("row", "paper: tPSNR / PPL", *_titles(metrics)), tuple(lines), (*_notes(metrics), note))


def _materials(document: Mapping[str, Any]) -> Table:
    titles = {"observed": "ensemble's mean", "own": "after the temporal solve"}
    lines = [
        (f"{plane}, {titles[source]}", *(number(m, numbers.get(m)) for m in MATERIAL))
        for plane, sources in document["material"]["mean"].items()
        for source, numbers in sources.items()
        if numbers
    ]
    return Table("Materials, mean ± std over shots", ("plane", *_titles(MATERIAL)), tuple(lines), _notes(MATERIAL))


def _measured(document: Mapping[str, Any]) -> Table:
    """Rows of a capture between Full and the ceiling, with the errors of their materials."""
    found = {row["name"]: row for row in document["rows"]}
    names = [name for name, row in found.items() if row["group"] == "evidence"]
    materials = {name: document["measured"]["mean"].get(name, {}) for name in names} if names else {}
    materials["full"] = {plane: numbers["own"] for plane, numbers in document["material"]["mean"].items() if names}
    lines, metrics = [], ("psnr", "psnr_aligned", "ssim", "flip")
    for name in ("full", "no_decomposition_each", *names, "full_true") if names else ():
        row, planes = found[name], materials.get(name, {})
        pairs = max((value.get("n", 0) for value in row["values"].values()), default=0)
        cells = [number(m, row["values"].get(m)) for m in metrics]
        errors = [number(m, planes.get(plane, {}).get(m)) for plane, m in _MEASURED]
        lines.append((row["title"], str(pairs), *cells, *errors))
    head = [f"{plane} {title}" for (plane, _), title in zip(_MEASURED, _titles([m for _, m in _MEASURED]), strict=True)]
    notes = (
        *(f"{found[name]['title']}: {found[name]['definition']}" for name in names),
        *_notes([*metrics, "rmse", "auc", "spearman"]),
        "RMSE and AUC of materials after the temporal solve, mean over shots; Spearman of the spread before it",
    )
    return Table("Materials measured by a capture", ("row", "pairs", *_titles(metrics), *head), tuple(lines), notes)


def _fitted(document: Mapping[str, Any]) -> Table:
    """Rows from cameras alone, and what each loses against the same materials on the given geometry."""
    found, lines = {row["name"]: row for row in document["rows"]}, []
    metrics = ("psnr", "psnr_whole", "ssim", "flip")
    for one in COUNTERPARTS if COUNTERPARTS[0].row.name in found else ():
        row, own = found[one.row.name], document["cells"].get(one.row.name, {})
        given = document["cells"].get(one.given, {})
        losses = [given[cell]["psnr"] - value["psnr"] for cell, value in own.items() if cell in given]
        loss = f"{fmean(losses):.2f}" if losses else "-"
        lines.append((row["title"], str(len(own)), *(number(m, row["values"].get(m)) for m in metrics), loss))
    geometry = document.get("geometry", {}).items()
    shots = [
        f"{shot}: normals {e['normals']:.1f} degrees, z {e['depth']:.1f} mm ({e['bias']:+.1f}), matte {e['matte']:.3f}"
        for shot, e in geometry
    ]
    notes = (
        "Cost of geometry [dB]: mean PSNR of the same materials on given plate, G-buffer and proxy, minus this row's",
        *(f"{one.row.title}: {one.row.definition}; against the row {one.given}" for one in COUNTERPARTS),
        "Fitted geometry (medians inside the given matte, z with its bias; matte: mean error where either covers). "
        + "; ".join(shots),
    )
    head = ("row", "pairs", *_titles(metrics), "cost of geometry, dB")
    return Table("From the cameras of a capture alone", head, tuple(lines), notes)


def _fitted_parts(document: Mapping[str, Any]) -> Table:
    """What each part of the fitted geometry costs, true materials and all other inputs as given."""
    found, metrics = document.get("geometry_parts", {}), ("psnr", "psnr_whole")
    titles = {"given": "all as given", **{part: f"fitted: {text}" for part, text in PARTS.items()}}
    lines = []
    for part, text in titles.items() if found else ():
        values = found[part]
        costs = [f"{found['given'][m]['mean'] - values[m]['mean']:.2f}" for m in metrics]
        lines.append((text, str(values["psnr"]["n"]), *(number(m, values.get(m)) for m in metrics), *costs))
    head = ("true materials", "pairs", *_titles(metrics), "cost inside, dB", "cost whole, dB")
    notes = (
        "One part from the fitted field, all others as given, under the probe maps; own coverage counts, over black",
    )
    return Table("What the fitted geometry costs, part by part", head, tuple(lines), notes)


_MEASURED = (
    ("roughness", "rmse"), ("roughness", "spearman"),
    ("metallic", "rmse"), ("metallic", "auc"), ("metallic", "spearman"),
)  # fmt: skip
"""Plane and metric of the columns about materials."""


def _flow(document: Mapping[str, Any]) -> Table:
    numbers = document["material"]["flow"]
    lines = [("our flow", *(number(m, numbers.get(m)) for m in FLOW))] if numbers else []
    seen = "A point is truly seen if the next frame has the same depth (to 3 %) and coverage where true flow leads"
    return Table("Flow, mean ± std over shots", ("", *_titles(FLOW)), tuple(lines), (*_notes(FLOW), seen))


def _unmodelled(document: Mapping[str, Any]) -> Table:
    found = document.get("unmodelled") or []
    lines = [
        (
            one["effect"],
            *(f"{one[key]:.4f}" for key in ("rmse", "with", "without")),
            "-" if one["share"] is None else f"{100 * one['share']:.0f} %",
            str(one["n"]),
        )
        for one in found
    ]
    head = (
        "effect",
        "RMSE of the effect",
        "ours, truth with it",
        "ours, truth without it",
        "share of the error",
        "pairs",
    )
    notes = dict.fromkeys(one["definition"] for one in found)
    share = "Share: of ours' mean squared error that would go with the effect (for bounces at most). Display values"
    return Table("Effects that are not modelled", head, tuple(lines), (*notes, share))


def _scaling(document: Mapping[str, Any]) -> Table:
    """The measurements of tests/benchmarks/evaluation_scaling.py."""
    found = document.get("scaling") or {"stages": {}, "lengths": {}}
    sizes = dict.fromkeys(size for stage in found["stages"].values() for size in stage)
    lines = [
        (stage, *(_cost(measured.get(size)) for size in sizes)) for stage, measured in found["stages"].items() if sizes
    ]
    lengths = "; ".join(f"{n} frames {_cost(one)}" for n, one in found["lengths"].items())
    notes = (
        "Processor seconds per frame on one core / peak memory in GB of a process that runs the stage alone",
        "fit_step: one step of a fit of 15,000 Gaussians, of which a frame takes hundreds or thousands "
        "(docs/gaussians.md); view: this field rendered as plate and G-buffer",
        f"Materials read, flow and chunked solve of a whole shot at 240x135: {lengths or 'not measured'}",
    )
    return Table("Time and memory", ("stage", *sizes), tuple(lines), notes)


def _cost(one: Mapping[str, float] | None) -> str:
    return "-" if one is None else f"{one['seconds']:.2f} s / {one['peak_bytes'] / 1e9:.2f} GB"
