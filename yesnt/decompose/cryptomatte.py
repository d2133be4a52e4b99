"""Coverage of named things from Cryptomatte's ranks (Friedman and Jones, "Cryptomatte specification", 1.2.0).

A rank is a pair of planes, an identifier and its coverage. An identifier is the MurmurHash3 of a name, made a float
that is neither denormal, infinite nor NaN. NumPy only.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import mmh3
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

_EXPONENT, _EXPONENT_BITS, _LOWEST_EXPONENT_BIT = 23, 0xFF, 1 << 23


def identifier(name: str) -> int:
    """The bits of the float that stands for a name: its 32-bit MurmurHash3, with a usable exponent."""
    hashed = mmh3.hash(name.encode("utf-8"), 0, signed=False)
    exponent = hashed >> _EXPONENT & _EXPONENT_BITS
    return hashed ^ _LOWEST_EXPONENT_BIT if exponent in (0, _EXPONENT_BITS) else hashed


def coverage(ranks: Iterable[tuple[Float32, Float32]], identifiers: Collection[int]) -> Float32:
    """Coverage [H, W] in [0, 1] of some identifiers together: the sum over all ranks.

    Args:
        ranks: identifier and coverage planes [H, W] of each rank; at least one.
        identifiers: bits of the identifiers.
    """
    wanted = np.array(sorted(identifiers), np.uint32)
    total = None
    for number, share in ranks:
        held = np.where(np.isin(number.view(np.uint32), wanted), share, np.float32(0))
        total = held if total is None else total + held
    assert total is not None
    return np.clip(total, 0, 1).astype(np.float32)  # sums of shares exceed 1 by rounding
