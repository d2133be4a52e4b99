"""Post-process of Blender's raw passes: the images of a shot (contract.md) as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import CorruptError

Plane = NDArray[np.floating]
Passes = Mapping[str, NDArray[np.float32]]
BACKGROUND_Z = 1e10
"""Planar z where nothing was hit: Cycles' own value."""


def read_passes(path: Path) -> dict[str, NDArray[np.float32]]:
    """Every channel of every part without the view layer's name: `Combined.R`, `Depth.Z`, `roughness.X`, ...

    Blender 5 writes one part a pass, earlier versions one part in all.

    Raises:
        CorruptError: the file does not decode.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as source:
            planes = [(name, channel.pixels) for part in source.parts for name, channel in part.channels.items()]
    except (OSError, RuntimeError, ValueError) as error:
        raise CorruptError(f"Blender's picture does not decode ({error})", str(path), "", "render it again") from error
    return {name.split(".", 1)[1]: np.asarray(plane, dtype=np.float32) for name, plane in planes}


def picture(lit: Passes) -> dict[str, Plane]:
    """The beauty pass: R, G, B, A half, scene-linear, associated; negative values (the denoiser's) become 0."""
    return {c: _half(np.maximum(lit[f"Combined.{c}"], 0)) for c in "RGBA"}


def materials(lit: Passes) -> dict[str, Plane]:
    """True base colour, roughness, metallic: half, antialiased and, like the plate, multiplied by coverage."""
    out = {f"base_color.{c}": _half(lit[f"base_color.{c}"]) for c in "RGB"}
    return {**out, "roughness.Y": _half(lit["roughness.X"]), "metallic.Y": _half(lit["metallic.X"])}


def geometry(points: Passes, lit: Passes) -> dict[str, Plane]:
    """Z and world normals at pixel centres; a pixel that is covered in part takes them from its nearest hit.

    Args:
        points: passes of the one-sample render through pixel centres.
        lit: passes of the antialiased render, for coverage.

    Returns:
        depth.Z float (metres, `BACKGROUND_Z` off the matte) and N.X, N.Y, N.Z half (unit length, 0 off the matte).
    """
    source, covered = _nearest_hit(points, lit)
    z = np.where(covered, points["Depth.Z"][source], np.float32(BACKGROUND_Z))
    normal = np.stack([points[f"Normal.{c}"][source] for c in "XYZ"], axis=-1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12) * covered[..., None]
    return {"depth.Z": z.astype(np.float32), **{f"N.{c}": _half(normal[..., i]) for i, c in enumerate("XYZ")}}


def flow(points: Passes, lit: Passes) -> dict[str, Plane]:
    """Pixels to the next frame, x right, y down, half; 0 off the matte.

    Blender's vector pass holds in Z, W where the point comes from, seen from the next frame, with y up: hence the
    minus on x and the y that is negated twice (checked by warping in tests/capture_stage).
    """
    source, covered = _nearest_hit(points, lit)
    u, v = -points["Vector.Z"][source], points["Vector.W"][source]
    return {"forward.u": _half(u * covered), "forward.v": _half(v * covered)}


def _nearest_hit(points: Passes, lit: Passes) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.bool_]]:
    """Per pixel, the index of the nearest pixel whose centre ray hit, and where the matte is above 0."""
    from scipy.ndimage import distance_transform_edt

    hit = points["Depth.Z"] < BACKGROUND_Z / 2
    covered = lit["Combined.A"] > 0
    if not hit.any():
        return tuple(np.indices(hit.shape)), covered & hit
    nearest = distance_transform_edt(~hit, return_distances=False, return_indices=True)
    return tuple(nearest), covered


def _half(plane: NDArray[np.floating]) -> Plane:
    return np.minimum(plane, 65504.0).astype(np.float16)
