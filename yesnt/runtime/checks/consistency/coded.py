"""Alpha that is stored in another range than 0 to 1: a certain mistake, refused by name."""

from __future__ import annotations

from yesnt.core.errors import JobError
from yesnt.io.shot_inputs import Plate

_ALPHA = 2.0
"""Alpha above which it cannot be coverage; reconstruction filters overshoot 1 by a fifth at most."""


def refuse_coded_alpha(plate: Plate, where: str) -> None:
    """Refuses alpha in 0 to 255 and the like, which would be read as 1 wherever it is not 0.

    Raises:
        JobError: alpha above 2.
    """
    if plate.alpha_peak > _ALPHA:
        raise JobError(
            f"Alpha goes up to {plate.alpha_peak:g}", f"plate, {where}", "coverage in 0 to 1",
            f"divide it by {255 if plate.alpha_peak <= 255 else 65535}, or name the right channel",
        )  # fmt: skip
