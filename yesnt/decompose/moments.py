"""Running mean and spread of the members of an ensemble, per pixel. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

_LEAST_FREEDOM = np.float32(1e-9)
"""Keeps the standard error finite, and very large, at pixels with a single independent member."""


class Moments:
    """Weighted mean and sum of squared deviations per pixel, updated member by member (West 1979).

    The mean that a backend predicts replaces the sample mean, since it is the limit of the sample mean without
    sampling noise (Rao-Blackwell); the spread always comes from the members. Single precision: 4K planes are large,
    and deviations of members need no more digits than the members have.

    Attributes:
        weight: [H, W] sum of the weights of the members so far.
    """

    def __init__(self, height: int, width: int) -> None:
        self.weight = np.zeros((height, width), np.float32)
        self._mean = np.zeros((2, height, width), np.float32)
        self._squares = np.zeros((2, height, width), np.float32)
        self._predicted: Float32 | None = None

    def set_mean(self, value: Float32) -> None:
        """Replaces the sample mean by a predicted mean [2, H, W]."""
        self._predicted = value

    def update(self, value: Float32, weight: Float32) -> None:
        """Adds a member.

        Args:
            value: [2, H, W] roughness and metallic.
            weight: [H, W] in [0, 1], the sum of the blending windows of the patches in which the member was drawn.
        """
        self.weight += weight
        gain = np.divide(weight, self.weight, out=np.zeros_like(self.weight), where=self.weight > 0)
        for plane, mean, squares in zip(value, self._mean, self._squares, strict=True):
            delta = plane - mean
            mean += gain * delta
            delta *= plane - mean
            squares += np.multiply(delta, weight, out=delta)

    @property
    def mean(self) -> Float32:
        """[2, H, W] predicted mean, or else the sample mean; 0 where there is no member."""
        return self._mean if self._predicted is None else self._predicted

    def std(self) -> Float32:
        """Returns the population standard deviation [2, H, W] over members; 0 where there is none."""
        variance = np.maximum(self._squares, 0)
        variance /= np.where(self.weight > 0, self.weight, np.float32(1))
        return np.sqrt(variance, out=variance)

    def standard_error(self, antithetic: bool) -> Float32:
        """Returns the standard error [2, H, W] of the mean of independent members; needs at least two members.

        Antithetic pairs lose no degree of freedom to the mean, because each pair is centred by construction; their
        lower variance is not counted. The error of a predicted mean is 0: more members would not change it.
        """
        if self._predicted is not None:
            return np.zeros_like(self._mean)
        freedom = self.weight - np.float32(0 if antithetic else 1)
        return self.std() / np.sqrt(np.maximum(freedom, _LEAST_FREEDOM))
