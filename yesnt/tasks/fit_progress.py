"""What a fit tells while it runs: the figures of its looks, and how a held-out camera sees the field."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.targets import Target
from yesnt.io.durable import write_bytes, write_json
from yesnt.io.pictures.png import png_bytes

F32 = NDArray[np.float32]

DIFFERENCE_GAIN = 4
"""By how much the difference is brightened in the picture."""


def progress_path(run: Path, frame: int) -> Path:
    """The file of a run folder that tells how far the fit of a frame is."""
    return run / "fit" / f"{frame:04d}.json"


def picture_path(run: Path, frame: int) -> Path:
    """The picture of the last look: a camera's picture, the field as this camera sees it, difference, normals."""
    return run / "fit" / f"{frame:04d}.png"


def tell_progress(
    run: Path, frame: int, looks: Sequence[dict[str, Any]], state: FitState, shown: Target, near: float
) -> None:
    """Writes the looks of a fit so far, and a picture of the last.

    Args:
        run: the run folder.
        frame: the frame that is fitted.
        looks: steps, Gaussians and PSNR of each look.
        state: of the fit.
        shown: the camera's picture that is compared with: a held-out camera's, if there is one.
        near: planar z in metres; what lies nearer is skipped.
    """
    path = progress_path(run, frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(picture_path(run, frame), png_bytes(compared(state, shown, near)))
    view = {name: np.asarray(value).tolist() for name, value in vars(shown.view).items()}
    write_json(path, {"frame": frame, "looks": list(looks), "view": view})


def compared(state: FitState, shown: Target, near: float) -> F32:
    """[H, 4 W, 3] display values: the picture, the field, their difference times 4, normals in camera axes."""
    from yesnt.gaussians.rasterise import pinhole_of, rasterise
    from yesnt.gaussians.render import rendered_view

    middle = state.values["positions"].mean(axis=0, dtype=np.float64)
    seen = rendered_view(rasterise(state.arrays, pinhole_of(shown.view, middle, near)), shown.view)
    difference = DIFFERENCE_GAIN * np.abs(seen.color - shown.color)
    normals = normal_colors(seen.normal, shown.view.rotation) * seen.alpha[..., None]
    return np.concatenate([shown.color, seen.color, difference, normals], axis=1).astype(np.float32)


def normal_colors(normals: F32, rotation: NDArray[np.float64]) -> F32:
    """Normals [..., 3] of the world as colours: x to the right, y up, z towards the camera, each from -1 to 1."""
    turned = normals @ (rotation.T * np.array([1.0, -1.0, -1.0])).astype(np.float32)
    return np.asarray(0.5 + 0.5 * turned, np.float32)
