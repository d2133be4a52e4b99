"""`yesnt stage`: checks the names, finds Blender, renders with progress."""

from __future__ import annotations

import sys
from pathlib import Path

from yesnt.core.errors import UsageError


def drive_stage(
    sets: list[str], out: Path, cache: Path, small: bool, fits: Path | None, workers: int | None, cluster: str
) -> int:
    """Renders what is missing; 3 if jobs failed.

    Raises:
        UsageError: an unknown set, or fits of other sets than `reference`.
        MissingPartError: Blender or anny is absent, or Blender too old.
    """
    from yesnt.capture_stage.jobs import SETS
    from yesnt.capture_stage.tools import stage_tools
    from yesnt.cli.progress import BarProgress, LineProgress
    from yesnt.runtime.capture_stage_run import CaptureStageContext, run_capture_stage
    from yesnt.runtime.launchers.spec import read_cluster

    unknown = sorted(set(sets) - set(SETS))
    if unknown:
        raise UsageError(f"No set {unknown[0]!r}", "yesnt stage", f"one of {', '.join(SETS)}", "check its spelling")
    if fits is not None and set(sets) != {"reference"}:
        raise UsageError("Only reference takes fits", "--fits", "yesnt stage reference --fits DIR", "leave it out")
    out = out if fits is None else fits
    context = CaptureStageContext(str(out.absolute()), stage_tools(cache.absolute()), fits is not None)
    progress = BarProgress() if sys.stdout.isatty() else LineProgress()
    with progress:
        outcome = run_capture_stage(sets, context, small, read_cluster(cluster, workers), progress)
    for node, reason in {**outcome.failed, **outcome.dead}.items():
        print(f"Failed: {node[0]} {node[1]}: {reason}")
    where = [str(out / name) for name in sets] if fits is None else [str(out / "shots" / "NAME" / "fitted" / "truth")]
    print(f"Sets: {', '.join(where)}")
    return 0 if outcome.complete else 3
