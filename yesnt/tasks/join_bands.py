"""Task that puts the bands of a chunk together to whole frames."""

from __future__ import annotations

from typing import Any

from yesnt.planning.task_records import JoinBandsTask
from yesnt.tasks.solve_window import known
from yesnt.tasks.workspace import Workspace


def join_bands(space: Workspace[JoinBandsTask]) -> None:
    """Commits the whole frames [2, H, W] of a chunk; each record holds the worst facts of its bands."""
    exchange, sweep = space.task.exchange, space.task.sweep
    bands = range(len(space.task.bands))
    for frame in space.pending():
        stages = exchange.before(exchange.blocks.index_of(space.job.position(frame)), bands, sweep)
        records = [space.book.find(stage, frame) for stage in stages.values()]
        worst: dict[str, Any] = {}
        for facts in (record.facts for record in records if record is not None):
            for name in {"seam", "gap"} & set(facts):
                worst[name] = max(worst.get(name, 0.0), facts[name])
        space.commit(frame, {"material": known(space, frame, bands, sweep)}, facts=worst)
