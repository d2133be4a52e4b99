"""Pictures of the page: small JPEG strips of plate, truth, ours and FLIP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.io.durable import write_bytes
from yesnt.metrics.flip import flip_map
from yesnt.metrics.score import Truth

PANELS = ("plate", "truth", "ours", "FLIP")
"""What a strip shows, from left to right."""

_QUALITY = 88  # JPEG: 110 strips stay below 5 MB, and no figure is read from them


def write_strip(path: Path, plate: NDArray[np.floating], ours: NDArray[np.floating], truth: Truth) -> None:
    """Writes the panels of one frame, cut to the subject."""
    import cv2

    shown = truth.shown(ours)
    error = np.rint(255 * np.clip(flip_map(shown, truth.display), 0, 1)).astype(np.uint8)
    magma = cv2.applyColorMap(error, cv2.COLORMAP_MAGMA)
    panels = [_bytes(picture)[..., ::-1] for picture in (truth.shown(plate), truth.display, shown)]
    strip = np.concatenate([*(panel[truth.frame] for panel in panels), magma[truth.frame]], axis=1)
    good, data = cv2.imencode(".jpg", strip, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not good:
        raise ValueError(f"JPEG cannot hold a picture of {strip.shape}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data.tobytes())


def _bytes(display: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(display, 0, 1)).astype(np.uint8)
