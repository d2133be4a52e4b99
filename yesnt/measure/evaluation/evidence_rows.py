"""Rows whose materials a capture measures: by so many cameras, and with errors that enter the evidence only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType

from yesnt.measure.evaluation.rows import Row

COUNTS = (1, 2, 4, 8, 12, 16)
"""Numbers of cameras, the plate not counted; 12 is the default of `evidence.cameras`."""

LADDER = 8
"""Cameras of the rows with errors."""


@dataclass(frozen=True)
class InputErrors:
    """Errors of the inputs of the evidence; relighting gets the true ones.

    Attributes:
        normals: root mean square angle by which normals are off, degrees; the same for neighbouring pixels.
        depth: share by which z is too large.
        light: root mean square share by which the capture map is off.
        gain: the same of a camera's red, green and blue.
    """

    normals: float = 0.0
    depth: float = 0.0
    light: float = 0.0
    gain: float = 0.0


@dataclass(frozen=True)
class Measured:
    """How the materials of a row are measured.

    Attributes:
        cameras: largest number of cameras.
        errors: of the inputs.
    """

    cameras: int
    errors: InputErrors = InputErrors()


_ERRORS = {
    "normals_5": ("normals off by 5 degrees", InputErrors(normals=5)),
    "normals_10": ("normals off by 10 degrees", InputErrors(normals=10)),
    "depth": ("z 1 % too large", InputErrors(depth=0.01)),
    "light": ("capture map off by 10 %", InputErrors(light=0.1)),
    "gain": ("cameras' colours off by 5 %", InputErrors(gain=0.05)),
    "all": ("normals 5 degrees, z 1 %, map 10 %, colours 5 %", InputErrors(5, 0.01, 0.1, 0.05)),
}


def _of_count(count: int) -> Row:
    title = f"Full with {count} camera{'s' if count > 1 else ''}"
    text = f"Full whose materials the plate and {count} cameras of the capture measure (evidence.cameras: {count})"
    return Row(f"cameras_{count}", title, "evidence", "measured", text)


def _of_errors(name: str, what: str) -> Row:
    text = f"as Full with {LADDER} cameras, and in the inputs of the evidence alone: {what}"
    return Row(f"cameras_{LADDER}_{name}", f"Full with {LADDER} cameras, {what}", "evidence", "measured", text)


MEASURED = MappingProxyType(
    {f"cameras_{count}": Measured(count) for count in COUNTS}
    | {f"cameras_{LADDER}_{name}": Measured(LADDER, errors) for name, (_, errors) in _ERRORS.items()}
)
"""How the materials of each row are measured, by the row's name."""

EVIDENCE_ROWS = MappingProxyType(
    {row.name: row for row in (*map(_of_count, COUNTS), *(_of_errors(n, what) for n, (what, _) in _ERRORS.items()))}
)
"""Rows of shots that have a capture."""


def shown_row(rows: Iterable[str]) -> str:
    """Of these rows the one of most cameras whose inputs have no errors: it is shown, its videos measured."""
    return max((row for row in rows if MEASURED[row].errors == InputErrors()), key=lambda row: MEASURED[row].cameras)
