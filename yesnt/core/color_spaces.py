"""Colour spaces by name, and what a job converts from one to another; the arithmetic is in io/color_config.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

LIN_REC709, ACESCG, SRGB = "lin_rec709", "acescg", "srgb"
"""Names that mean the same under every OpenColorIO configuration: linear Rec.709, ACEScg, sRGB (IEC 61966-2-1)."""

WORKING = (LIN_REC709, ACESCG)
"""Spaces that light may be computed in."""

_D65, _D60 = (0.3127, 0.3290), (0.32168, 0.33767)

PRIMARIES = MappingProxyType(
    {
        "lin_rec709_scene": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *_D65),
        "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, *_D60),
        "lin_ap0_scene": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, *_D60),
        "lin_p3d65_scene": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65),
        "lin_rec2020_scene": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
        "lin_adobergb_scene": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65),
    }
)
"""Linear spaces by interop identifier (Color Interop Forum): red, green, blue, white x, y as EXR files state them."""

INTEROP_OF = MappingProxyType({LIN_REC709: "lin_rec709_scene", ACESCG: "lin_ap1_scene", SRGB: "srgb_rec709_scene"})
"""Interop identifier of our own names."""

NAMED_BY_INTEROP = MappingProxyType({identifier: name for name, identifier in INTEROP_OF.items()})
"""Our own name of an interop identifier."""

_SAME = 0.02
"""Largest difference of two matrices to Rec.709 that mean one space: Bradford and CAT02 adaptation differ by 0.01."""

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


@dataclass(frozen=True)
class Conversion:
    """From one colour space to another.

    Attributes:
        source: name of the space that colours are in: one of our own, or one that `config` knows.
        target: name of the space that they are wanted in; of a display, "DISPLAY/VIEW".
        config: configuration that OpenColorIO opens; "" where none is needed.
        digest: of the arithmetic, tables included; "" where OpenColorIO is not needed. It enters the keys.
    """

    source: str = LIN_REC709
    target: str = LIN_REC709
    config: str = ""
    digest: str = ""

    @property
    def changes(self) -> bool:
        """Whether there is anything to convert."""
        return self.source != self.target


@dataclass(frozen=True)
class OutputSpace:
    """The space of the delivered EXRs, as their headers state it.

    Attributes:
        name: as the job file has it.
        interop: interop identifier; "" if the space has none.
        chromaticities: red, green, blue, white x, y.
    """

    name: str = LIN_REC709
    interop: str = INTEROP_OF[LIN_REC709]
    chromaticities: tuple[float, ...] = PRIMARIES["lin_rec709_scene"]


@dataclass(frozen=True)
class JobColors:
    """All conversions of a job.

    Attributes:
        plate: to linear Rec.709, for the decomposition and the optical flow.
        plate_working: of the plate to the working space, for relighting.
        background: to the working space.
        light: of the map that relights, to the working space.
        capture_light: of the map that the plate was captured under, to the working space.
        capture: of the pictures of the capture's cameras, to the working space.
        scene: of Blender's pictures, which are linear Rec.709, to the working space.
        to_scene: from the working space to linear Rec.709.
        output: from the working space to the space of the delivered EXRs.
        display: from there to the preview's display.
        output_space: what the EXRs' headers state.
    """

    plate: Conversion = Conversion()
    plate_working: Conversion = Conversion()
    background: Conversion = Conversion()
    light: Conversion = Conversion()
    capture_light: Conversion = Conversion()
    capture: Conversion = Conversion()
    scene: Conversion = Conversion()
    to_scene: Conversion = Conversion()
    output: Conversion = Conversion()
    display: Conversion = Conversion(target=SRGB)
    output_space: OutputSpace = field(default_factory=OutputSpace)

    def digests(self, *roles: str) -> dict[str, str]:
        """Digests of the conversions of these roles, where OpenColorIO is used; they enter the keys."""
        found: dict[str, Conversion] = {role: getattr(self, role) for role in roles}
        return {role: conversion.digest for role, conversion in found.items() if conversion.digest}


def matrix_to_rec709(chromaticities: Sequence[float]) -> Float64:
    """Matrix [3, 3] from linear RGB of these chromaticities to linear Rec.709, white adapted by Bradford.

    Source: Lindbloom, "RGB/XYZ Matrices" and "Chromatic Adaptation".

    Raises:
        ValueError: the chromaticities span no colour space.
    """
    values = np.asarray(chromaticities, dtype=np.float64)
    if values.shape != (8,) or not np.isfinite(values).all() or (values[1::2][-1:] == 0).any():
        raise ValueError("chromaticities are eight finite numbers, and the white's y is not 0")
    try:
        return np.linalg.inv(_to_xyz(PRIMARIES["lin_rec709_scene"])) @ _to_xyz(chromaticities)
    except np.linalg.LinAlgError as error:
        raise ValueError("the primaries lie on one line") from error


def _to_xyz(chromaticities: Sequence[float]) -> Float64:
    """Matrix [3, 3] from linear RGB to XYZ adapted to D65."""
    pairs = np.asarray(chromaticities, dtype=np.float64).reshape(4, 2)
    primaries = np.column_stack([pairs[:3, 0], pairs[:3, 1], 1 - pairs[:3].sum(axis=1)]).T
    white = _white(pairs[3])
    matrix = primaries * np.linalg.solve(primaries, white)
    cones = _BRADFORD @ _white(_D65) / (_BRADFORD @ white)
    return np.linalg.inv(_BRADFORD) @ (cones[:, None] * _BRADFORD) @ matrix


def _white(xy: Sequence[float] | Float64) -> Float64:
    x, y = xy
    return np.array([x / y, 1, (1 - x - y) / y])


def same_space(one: Float64, other: Float64) -> bool:
    """Whether two matrices to Rec.709 [3, 3] mean the same primaries, whatever the adaptation of their whites."""
    return bool(np.abs(one - other).max() <= _SAME)


def space_of_chromaticities(chromaticities: Sequence[float]) -> str | None:
    """Interop identifier of a linear space by its chromaticities; None of others.

    Raises:
        ValueError: the chromaticities span no colour space.
    """
    found = matrix_to_rec709(chromaticities)
    near = (name for name, known in PRIMARIES.items() if same_space(found, matrix_to_rec709(known)))
    return next(near, None)


def chromaticities_of(matrix: Float64) -> tuple[float, ...]:
    """Chromaticities (white D65) of the linear RGB that a matrix [3, 3] takes to linear Rec.709."""
    xyz = _to_xyz(PRIMARIES["lin_rec709_scene"]) @ matrix
    return (*(xyz[:2] / xyz.sum(axis=0)).T.ravel().tolist(), *_D65)
