"""NaN and infinite values of pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError


def not_finite(vectors: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels [H, W] of which a component is NaN or infinite."""
    return np.asarray(~np.isfinite(vectors).all(axis=-1))


def refuse_not_finite(bad: NDArray[np.bool_], where: str, channels: str, remedy: str = "mend this picture") -> None:
    """Refuses a picture that has such values.

    Args:
        bad: [H, W] or [H, W, C], where they are.
        where: the file.
        channels: their names.
        remedy: what to do.

    Raises:
        JobError: counts them, and says where the first is.
    """
    count = int(bad.sum())
    if count:
        y, x = (int(v[0]) for v in np.nonzero(bad)[:2])
        raise JobError(
            f"{count} values are NaN or Inf in {channels}",
            f"{where}, first at x={x} y={y}",
            "finite numbers",
            remedy,
        )
