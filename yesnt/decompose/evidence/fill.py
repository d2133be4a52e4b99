"""Materials of pixels that nothing measured, from measured pixels of the same frame that look alike.

Where the flow from a measured frame is lost, as at the border of an arm that moves, the surface is mostly one that was
measured beside it. The model's error there is known (`roughness_error`, `metallic_error`), and larger than that of a
neighbour of the same colour.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.confidence import LARGEST_STD
from yesnt.decompose.evidence.settings import EvidenceSettings

F32 = NDArray[np.float32]
Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

NEAR = 0.1
"""Distance of two pixels that counts 1, over the root of the number of the subject's pixels."""

CHROMA = 0.1
"""Difference of log chromaticity that counts 1."""

INTENSITY = 0.5
"""Difference of log intensity that counts 1; large, since shading changes it too."""

REACH = 3.0
"""Distance, in these units, at which the nearest measured pixel counts 0.6 and the model the rest."""

_ALIKE = 32  # measured pixels that are averaged
_LEAST_WIDTH = 0.3  # of their weights: nearer ones are alike
_DARK = 1e-3  # radiance that a logarithm is taken of, at least


class Materials(NamedTuple):
    """Planes of roughness and metallic.

    Attributes:
        mean: [2, H, W] in [0, 1].
        std: [2, H, W] standard deviation.
    """

    mean: F32
    std: F32


def filled(found: Materials, known: Mask, plate: F32, inside: Mask, settings: EvidenceSettings) -> Materials:
    """The same, where the subject's unknown pixels follow known ones that look alike.

    A filled pixel is a mixture: of `_ALIKE` known pixels, the nearest by place and colour, with a share that falls with
    the distance of the nearest, and of its own estimate, the error of which is the members' and the model's.

    Args:
        found: measured where known, else the model's estimate.
        known: [H, W] where the cameras measured.
        plate: [H, W, 3] scene-linear.
        inside: [H, W] the subject's pixels.
        settings: `roughness_error` and `metallic_error`.
    """
    from scipy.spatial import cKDTree

    wanted, source = inside & ~known, inside & known
    if not wanted.any() or not source.any():
        return found
    features = looks(plate, inside)
    alike = min(_ALIKE, int(source.sum()))
    distance, which = cKDTree(features[source]).query(features[wanted], k=alike)
    distance, which = distance.reshape(-1, alike), which.reshape(-1, alike)
    width = np.maximum(distance[:, :1], _LEAST_WIDTH)
    weight = np.exp(-0.5 * np.square(distance / width))
    weight *= np.exp(-0.5 * np.square(distance[:, :1] / REACH)) / weight.sum(axis=1, keepdims=True)
    mean, std = found.mean.copy(), found.std.copy()
    for i, error in enumerate((settings.roughness_error, settings.metallic_error)):
        own = mean[i][wanted].astype(np.float64), np.hypot(std[i][wanted].astype(np.float64), error)
        others = mean[i][source].astype(np.float64)[which], std[i][source].astype(np.float64)[which]
        mean[i][wanted], std[i][wanted] = mixture(own, others, weight)
    return Materials(mean, std)


def mixture(own: tuple[Float, Float], others: tuple[Float, Float], weight: Float) -> tuple[Float, Float]:
    """Mean and standard deviation [N] of a mixture of others [N, K] by their weights and of one's own [N] by the rest.

    Args:
        own: mean and standard deviation [N].
        others: the same [N, K].
        weight: [N, K], of sum at most 1.
    """
    rest = 1 - weight.sum(axis=1)
    mean = (weight * others[0]).sum(axis=1) + rest * own[0]
    square = (weight * (np.square(others[1]) + np.square(others[0] - mean[:, None]))).sum(axis=1)
    square += rest * (np.square(own[1]) + np.square(own[0] - mean))
    return mean, np.minimum(np.sqrt(square), LARGEST_STD)


def looks(plate: F32, inside: Mask) -> Float:
    """Place and colour [H, W, 5] of every pixel, in units in which a distance of 1 is small."""
    rows, columns = np.mgrid[: inside.shape[0], : inside.shape[1]]
    unit = max(NEAR * float(np.sqrt(inside.sum())), 1.0)
    logs = np.log(np.maximum(np.nan_to_num(plate), _DARK)).astype(np.float64)
    intensity = logs.mean(axis=-1, keepdims=True)
    place = np.stack([rows, columns], axis=-1) / unit
    return np.concatenate([place, (logs - intensity) / CHROMA, intensity / INTENSITY], axis=-1)
