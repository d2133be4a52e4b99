"""`yesnt run --share`: one process of a farm that starts one per range of frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from yesnt.cli import text

if TYPE_CHECKING:
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session


def refuse_with_share(given: Mapping[str, object]) -> None:
    """Refuses options that belong to a driver.

    Raises:
        UsageError: one of them is given.
    """
    from yesnt.core.errors import UsageError

    for option, value in given.items():
        if value:
            raise UsageError(
                f"A shared run has no driver that {option} could mean", f"--share {option}", "one of them",
                "leave one out: with --share each process works alone and takes what no other does",
            )  # fmt: skip


def drive_shared(session: Session, options: RunOptions, json: bool) -> int:
    """Runs and prints a line for each task; 3 if frames are missing."""
    from yesnt.cli.progress import line_progress
    from yesnt.cli.results import result_lines
    from yesnt.runtime.control.share import run_shared

    megapixels = session.job.width * session.job.height / 1e6
    result = run_shared(session, options) if json else run_shared(session, options, line_progress(megapixels))
    missing = [{"stage": str(s), "frame": f, "why": why} for (s, f), why in result.missing.items()]
    if json:
        found: dict[str, Any] = {
            "done": len(result.outcome.done),
            "missing": missing,
            "warnings": result.warnings,
            "notes": list(result.notes),
        }
        text.print_json({**found, "exr": str(session.output.exr)})
        return 3 if missing else 0
    text.print_findings(result.notes, result.warnings)
    for row in missing:
        print(f"Missing: frame {row['frame']} of {row['stage']}: {row['why']}")
    print("\n".join([*result_lines(session.output), ""]), end="")
    return 3 if missing else 0
