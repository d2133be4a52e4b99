"""FLIP (Andersson et al. 2020) and HDR-FLIP (Andersson et al. 2021), computed by NVIDIA's package flip-evaluator.

FLIP is the error that a viewer sees when two pictures are shown in turn at the same place, per pixel in [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import flip_evaluator
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.floating]
Float = NDArray[np.float64]

PIXELS_PER_DEGREE = 3840 * math.pi / 180
"""67.02: a screen of 3840 pixels that is as wide as it is far away (0.7 m), the paper's default."""


def flip_map(display: Picture, truth: Picture, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Float:
    """FLIP [H, W] in [0, 1] of two sRGB-encoded pictures [H, W, 3] in [0, 1].

    Raises:
        ValueError: the pictures are not two of one shape [H, W, 3].
    """
    error, _ = _evaluate("LDR", display, truth, {"ppd": pixels_per_degree})
    return error


def hdr_flip_map(
    radiance: Picture, truth: Picture, exposures: Sequence[float], pixels_per_degree: float = PIXELS_PER_DEGREE
) -> Float:
    """HDR-FLIP [H, W] in [0, 1]: the largest FLIP over evenly spaced exposures, tone-mapped with the ACES curve.

    Args:
        radiance: scene-linear picture [H, W, 3], >= 0.
        truth: the same for the reference.
        exposures: in stops, evenly spaced, ascending, as `exposure_range` gives them.
        pixels_per_degree: of the viewer's field of view.

    Raises:
        ValueError: the pictures are not two of one shape [H, W, 3].
    """
    parameters = {
        "ppd": pixels_per_degree, "tonemapper": "ACES",
        "startExposure": exposures[0], "stopExposure": exposures[-1], "numExposures": len(exposures),
    }  # fmt: skip
    error, _ = _evaluate("HDR", radiance, truth, parameters)
    return error


def exposure_range(truth: Picture) -> tuple[float, ...]:
    """Exposures in stops for HDR-FLIP from the truth's pixels [..., 3]: those that show its maximum to its median.

    Evenly spaced, one a stop or denser, at least two (2021, section 4). The median must be above 0.
    """
    pixels = np.asarray(truth, np.float32).reshape(1, -1, 3)
    _, used = _evaluate("HDR", pixels, pixels, {"tonemapper": "ACES", "numExposures": 2})
    start, stop = used["startExposure"], used["stopExposure"]
    return tuple(float(stops) for stops in np.linspace(start, stop, max(2, math.ceil(stop - start))))


def _evaluate(
    dynamic_range: str, picture: Picture, truth: Picture, parameters: dict[str, Any]
) -> tuple[Float, dict[str, Any]]:
    """The error map [H, W] and the parameters that flip-evaluator used."""
    test, reference = (np.ascontiguousarray(p, dtype=np.float32) for p in (picture, truth))
    if test.shape != reference.shape or test.ndim != 3 or test.shape[2] != 3:  # the package would end the process
        raise ValueError(f"FLIP needs two pictures of one shape [H, W, 3], not {test.shape} and {reference.shape}")
    error, _, used = flip_evaluator.evaluate(
        reference, test, dynamic_range, applyMagma=False, computeMeanError=False, parameters=parameters
    )
    return error[..., 0].astype(np.float64), used
