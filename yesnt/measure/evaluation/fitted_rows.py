"""Rows whose plate, matte, normals, depth and proxy come from a Gaussian field that is fitted to the capture."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from yesnt.measure.evaluation.rows import Row

CAMERAS = 8
"""Cameras that measure the materials; all cameras of the capture are fitted."""


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


COUNTERPARTS = (
    _counterpart("true", "true materials", "true", "full_true"),
    _counterpart("model", "the model's materials", "observed", "unregularised"),
    _counterpart("cameras", f"materials measured by {CAMERAS} cameras", "measured", f"cameras_{CAMERAS}"),
)

FITTED_ROWS = MappingProxyType({one.row.name: one.row for one in COUNTERPARTS})
"""Rows of shots whose fields are fitted, by name."""
