"""Counter-based noise keyed by job, frame and member: the same bits in any order (method.md section 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def noise_field(
    seed: int, frame: int, member: int, height: int, width: int, components: int = 2
) -> NDArray[np.float32]:
    """One full-frame standard normal field; patches crop it.

    Args:
        seed: the job's seed, 0 .. 2^64-1.
        frame: frame number as delivered (negative ones are legal).
        member: ensemble member k.
        height: rows.
        width: columns.
        components: planes.

    Returns:
        [components, H, W] float32. Philox 4x64 (Salmon et al. 2011): the key is the seed, the counter starts at
        (frame, member), so fields of different frames or members never overlap.
    """
    counter = np.array([0, 0, np.int64(frame).astype(np.uint64), member], dtype=np.uint64)
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, 0x7965736E74], dtype=np.uint64)
    generator = np.random.Generator(np.random.Philox(counter=counter, key=key))
    return generator.standard_normal((components, height, width), dtype=np.float32)
