"""Random choices keyed by seed, frame and a counter: the same in any order of work."""

from __future__ import annotations

import numpy as np

_PURPOSE = 0x676175737369616E  # "gaussian": keeps these numbers apart from the noise of core/noise.py


def keyed_generator(seed: int, frame: int, number: int) -> np.random.Generator:
    """A generator of its own for (seed, frame, number): Philox 4x64 (Salmon et al. 2011)."""
    counter = np.array([0, 0, np.int64(frame).astype(np.uint64), number], dtype=np.uint64)
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, _PURPOSE], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(counter=counter, key=key))
