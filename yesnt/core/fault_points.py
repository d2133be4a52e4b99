"""Named points at which a test may end the process, to prove that an end there costs nothing but work in flight.

`YESNT_FAULT="record.before_commit:3:/tmp/token"` kills with SIGKILL the first process that reaches that point for the
third time and manages to remove the token, so that of several workers one dies, once. A fourth part says how it ends:
`kill` (SIGKILL), `segfault`, or `exit` (`sys.exit` in the middle of a task). With the variable unset a point costs one
look-up in the environment.
"""

from __future__ import annotations

import os
import signal
import sys
from collections import Counter

_VARIABLE = "YESNT_FAULT"
_SIGNALS = {"kill": signal.SIGKILL, "segfault": signal.SIGSEGV}
_reached: Counter[str] = Counter()  # per process, so that ":3" can mean "the third time here"


def fault_point(name: str) -> None:
    """Ends this process if `YESNT_FAULT` names this point, it was reached often enough, and the token was there."""
    asked = os.environ.get(_VARIABLE)
    if not asked:
        return
    point, count, token, *how = asked.split(":")
    if point != name:
        return
    _reached[name] += 1
    if _reached[name] >= int(count):
        try:
            os.unlink(token)
        except FileNotFoundError:
            return
        if how and how[0] == "exit":
            sys.exit("a fault that a test planted")
        os.kill(os.getpid(), _SIGNALS[how[0] if how else "kill"])
