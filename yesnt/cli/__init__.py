"""The command line: parse, call, print. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import _thread
import os
import sys
import threading
from typing import Any, NoReturn

from yesnt.core.errors import ClusterLostError, YesntError

INTERRUPTED = 130
AT_ONCE = (INTERRUPTED, ClusterLostError.exit_status)
"""Exit statuses after which the process does not wait for threads: of a cluster that is starting, or that is gone."""


def main() -> None:
    """Entry point of `yesnt`; maps every end of a command to its exit status (docs/contract.md)."""
    sys.unraisablehook = repeat_lost_interrupt
    try:
        status = _run()
    except KeyboardInterrupt:
        status = INTERRUPTED
    if status == INTERRUPTED:
        print("Interrupted: what is committed stays, the same command goes on from there.", file=sys.stderr)
    if os.environ.get("YESNT_SUBMISSION"):
        from yesnt.cli.control import note_submission_end

        note_submission_end(status or 0)
    if status in AT_ONCE:
        _exit_at_once(status)
    sys.exit(status or 0)


def repeat_lost_interrupt(lost: Any) -> None:
    """Interrupts the main thread once more where Python has dropped the first interrupt.

    A `KeyboardInterrupt` that is raised while a finaliser runs (Dask's futures have one) is printed and forgotten: the
    run would go on as if the user had not pressed Ctrl-C. For `sys.unraisablehook`; all else goes to Python's own hook.
    """
    if issubclass(lost.exc_type, KeyboardInterrupt):
        # Not here: the finaliser that called this has not returned, and the interrupt would be lost again.
        threading.Timer(0.05, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(lost)


def _exit_at_once(status: int) -> NoReturn:
    from yesnt.runtime.cluster.stop_cluster import kill_children

    kill_children()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _run() -> int | None:
    """Runs the command of `sys.argv` and prints its error, if it has one; returns the exit status."""
    import typer

    from yesnt.cli.app import app
    from yesnt.cli.text import print_error

    try:
        status: int | None = app(standalone_mode=False)
        return status
    except YesntError as error:
        print_error(error, as_json="--json" in sys.argv)
        return error.exit_status
    except typer.Abort:
        return INTERRUPTED
    except OSError as error:
        from yesnt.io.durable import disk_full, is_full

        if not is_full(error):
            raise
        print_error(disk_full(error), as_json="--json" in sys.argv)
        return 1
    except Exception as error:
        # Usage errors come from click, or from typer's own copy of it, by release: both can show themselves.
        if not hasattr(error, "show") or not hasattr(error, "exit_code"):
            raise
        error.show()
        code: int = error.exit_code
        return code
