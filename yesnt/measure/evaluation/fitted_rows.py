"""Rows whose plate, matte, normals, depth and proxy come from a Gaussian field that is fitted to the capture."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from yesnt.measure.evaluation.rows import Row

CAMERAS = 8
"""Cameras that measure the materials; all cameras of the capture are fitted."""

BLENDER = "fitted_blender"
"""The row that Blender renders of the fitted mesh."""

STRIP_ROW = "fitted_cameras"
"""The row whose picture the page shows, beside the same with true materials."""


@dataclass(frozen=True)
class Counterpart:
    """A row from cameras alone, and the row that has the true geometry in its place.

    Attributes:
        row: as it is scored.
        given: name of the row with the given plate, G-buffer and proxy; the difference is what geometry costs.
    """

    row: Row
    given: str


def _counterpart(name: str, title: str, source: str, given: str) -> Counterpart:
    text = "Full on the plate, G-buffer and proxy of a Gaussian field fitted to the capture"
    row = Row(f"fitted_{name}", f"Full, fitted geometry, {title}", "fitted", source, f"{text}; {title}")  # type: ignore[arg-type]
    return Counterpart(row, given)


_IN_BLENDER = Row(
    BLENDER, "Proxy in Blender, fitted mesh", "fitted", "blender",
    "Cycles relights the fitted mesh with the colours of the fitted view (yesnt stage reference --fits)",
)  # fmt: skip

COUNTERPARTS = (
    _counterpart("true", "true materials", "true", "full_true"),
    _counterpart("model", "the model's materials", "observed", "unregularised"),
    _counterpart("cameras", f"materials measured by {CAMERAS} cameras", "measured", f"cameras_{CAMERAS}"),
    Counterpart(_IN_BLENDER, "blender_proxy"),
)

FITTED_ROWS = MappingProxyType({one.row.name: one.row for one in COUNTERPARTS})
"""Rows of shots whose fields are fitted, by name."""
