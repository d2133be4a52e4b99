"""The command line: parse, call, print. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import sys

import click

from yesnt.errors import YesntError


def main() -> None:
    """Entry point of `yesnt`; maps every end of a command to its exit status (contract.md)."""
    from yesnt.cli.app import app
    from yesnt.cli.text import print_error

    try:
        status = app(standalone_mode=False)
    except YesntError as error:
        print_error(error, as_json="--json" in sys.argv)
        status = error.exit_status
    except click.UsageError as error:
        error.show()
        status = 2
    except (KeyboardInterrupt, click.Abort):
        print("Interrupted: what is committed stays, the same command goes on from there.", file=sys.stderr)
        status = 130
    sys.exit(status or 0)
