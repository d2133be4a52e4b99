"""The command line: parse, call, print. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import sys

from yesnt.core.errors import YesntError

INTERRUPTED = 130


def main() -> None:
    """Entry point of `yesnt`; maps every end of a command to its exit status (contract.md)."""
    import typer

    from yesnt.cli.app import app
    from yesnt.cli.text import print_error

    try:
        status = app(standalone_mode=False)
    except YesntError as error:
        print_error(error, as_json="--json" in sys.argv)
        status = error.exit_status
    except (KeyboardInterrupt, typer.Abort):
        status = INTERRUPTED
    except OSError as error:
        from yesnt.io.durable import disk_full, is_full

        if not is_full(error):
            raise
        print_error(disk_full(error), as_json="--json" in sys.argv)
        status = 1
    except Exception as error:
        # Usage errors come from click, or from typer's own copy of it, by release: both can show themselves.
        if not hasattr(error, "show") or not hasattr(error, "exit_code"):
            raise
        error.show()
        status = error.exit_code
    if status == INTERRUPTED:
        print("Interrupted: what is committed stays, the same command goes on from there.", file=sys.stderr)
    sys.exit(status or 0)
