"""Compiles the kernels of the set by lighting two tiny pixels with the types that the tasks use."""

from __future__ import annotations

import numpy as np

from yesnt.scene.set_brdf import SetBrdf
from yesnt.scene.set_kernels import SampleHits, sum_samples


def precompile_set() -> None:
    """Kernels of the light on the set."""
    count = 2  # NumPy calls every view of a single element contiguous, and Numba compiles once per memory layout
    number, yes = np.zeros(count, np.int64), np.ones(count, np.bool_)
    color, up = np.ones((count, 3), np.float32), np.array([[0, 0, 1]] * count, np.float32)
    brdf = SetBrdf(up, up, 0.5, color, color, color, color[:, 0].copy(), -1.0)
    samples = np.ascontiguousarray(up.T), np.ascontiguousarray(color.T), np.ones(count, np.float32)
    hits = SampleHits(number, number, number, yes, yes, color, color)
    sum_samples(hits, brdf, samples, False, np.zeros((count, 9)))
