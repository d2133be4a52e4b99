"""Named points at which a test may kill the process, to prove that a kill there costs nothing but work in flight.

`YESNT_FAULT="store.before_rename:3"` kills the process with SIGKILL the third time that it reaches that point. With the
variable unset a point costs one dictionary look-up.
"""

from __future__ import annotations

import os
import signal
from collections import Counter

_VARIABLE = "YESNT_FAULT"
_reached: Counter[str] = Counter()  # per process, so that ":N" can mean "the N-th time here"


def fault_point(name: str) -> None:
    """Kills this process if `YESNT_FAULT` names this point and it has been reached often enough."""
    asked = os.environ.get(_VARIABLE)
    if not asked:
        return
    point, _, count = asked.partition(":")
    if point != name:
        return
    _reached[name] += 1
    if _reached[name] == int(count or 1):
        os.kill(os.getpid(), signal.SIGKILL)
