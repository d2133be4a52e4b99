"""Pictures of the page: JPEG strips of plate, truth, our result and FLIP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.io.durable import write_bytes
from yesnt.metrics.flip import flip_map
from yesnt.metrics.score import Truth, box_of

PANELS = ("plate", "truth", "ours", "FLIP of ours", "ours with true materials")
"""Panels of a strip, from left to right."""

MATERIAL_PANELS = ("plate", "true roughness", "ours", "standard deviation", "true metal", "ours", "standard deviation")
"""Panels of a strip of materials, from left to right."""

_QUALITY = 88  # JPEG: 110 strips stay below 5 MB; no number is measured on them


def strip_name(name: str, frame: int, row: str) -> str:
    """File name of the strip that shows a row for one frame under one map."""
    return f"{name}.{frame:04d}.{row}.jpg"


def write_strip(
    path: Path,
    plate: NDArray[np.floating],
    ours: NDArray[np.floating],
    ceiling: NDArray[np.floating] | None,
    truth: Truth,
    opacity: NDArray[np.float32] | None = None,
) -> None:
    """Writes the panels of one frame, cut to the subject.

    Args:
        path: of the JPEG.
        plate: [H, W, 3] straight, scene-linear.
        ours: [H, W, 3] our relit picture, straight, scene-linear.
        ceiling: [H, W, 3] the same with true materials, or None.
        truth: the reference rendered in Blender.
        opacity: coverage [H, W] of plate, ours and ceiling; None: the truth's.
    """
    shown = truth.shown(ours, opacity)
    panels = [_bytes(picture) for picture in (truth.shown(plate, opacity), truth.display, shown)]
    panels.append(_heat(flip_map(shown, truth.display)))
    if ceiling is not None:
        panels.append(_bytes(truth.shown(ceiling, opacity)))
    _write(path, [panel[truth.frame] for panel in panels])


def write_materials(
    path: Path, plate: NDArray[np.floating], maps: Sequence[NDArray[np.floating]], matte: NDArray[np.floating]
) -> None:
    """Writes the plate [H, W, 3] and maps [H, W] of numbers in 0..1 side by side, cut to the matte [H, W]."""
    frame = box_of(matte > 0, 8)
    panels = [_bytes(srgb_encode(plate * matte[..., None]))]
    panels += [_bytes(np.repeat((values * matte)[..., None], 3, axis=-1)) for values in maps]
    _write(path, [panel[frame] for panel in panels])


def _write(path: Path, panels: Sequence[NDArray[np.uint8]]) -> None:
    import cv2

    good, data = cv2.imencode(".jpg", np.concatenate(panels, axis=1)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not good:
        raise ValueError(f"JPEG cannot hold panels of {panels[0].shape}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data.tobytes())


def _heat(error: NDArray[np.floating]) -> NDArray[np.uint8]:
    import cv2

    colors: NDArray[np.uint8] = cv2.applyColorMap(
        np.rint(255 * np.clip(error, 0, 1)).astype(np.uint8), cv2.COLORMAP_MAGMA
    )
    return colors[..., ::-1]


def _bytes(display: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(display, 0, 1)).astype(np.uint8)
