"""The numbers of a run: states of frames, times, memory, solver, network evaluations, timeline."""

from __future__ import annotations

import json
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from yesnt.core.stage_id import StageId
from yesnt.inspect.frame_states import states
from yesnt.measure.trade.run import read_trade
from yesnt.planning.stages import STAGES, find_stage
from yesnt.report.fits import fit_facts
from yesnt.runtime.session import Session


def gather(session: Session) -> dict[str, Any]:
    """All numbers of the page as plain JSON data."""
    graph = session.graph()
    found = states(session, graph)
    counts = Counter((StageId.parse(s.stage).name, s.state) for s in found)
    records = [session.book.find(s.stage, s.frame) for s in found if s.state == "done"]
    shown = [name for name, row in STAGES.items() if not row.optional or any(stage == name for stage, _ in counts)]
    rows = [_row(stage, counts, [r for r in records if r is not None and r.stage == stage]) for stage in shown]
    return {
        "name": session.job.shot.name,
        "size": [session.job.width, session.job.height],
        "frames": [session.job.frames[0], session.job.frames[-1], len(session.job.frames)],
        "stages": rows,
        "unfinished": [
            {"stage": s.stage, "frame": s.frame, "state": s.state, "why": s.why} for s in found if s.state != "done"
        ],
        "solver": _solver([r.facts for r in records if r is not None and r.stage == "solve"]),
        "fits": fit_facts(session),
        "sampling": _sampling([r for r in records if r is not None and r.stage == "decompose"]),
        "trade": read_trade(session.output.run),
        "tasks": _tasks(session),
        "job": session.job.shot.model_dump(mode="json"),
    }


def _row(stage: str, counts: Counter[tuple[str, str]], records: list[Any]) -> dict[str, Any]:
    tasks = [r.seconds["task"] for r in records]
    kernels = [r.seconds["kernel"] for r in records]
    return {
        "stage": stage,
        "done": counts[stage, "done"],
        "not_done": sum(n for (name, state), n in counts.items() if name == stage and state != "done"),
        "median_seconds": statistics.median(tasks) if tasks else None,
        "median_kernel_seconds": statistics.median(kernels) if kernels else None,
        "peak_bytes": max((r.facts["peak_bytes"] for r in records), default=None),
    }


def _solver(facts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Iterations and the certified relative gap, worst over chunks."""
    return {
        name: max((fact[name] for fact in facts if name in fact), default=None)
        for name in ("iterations", "gap", "pixels")
    }


def _sampling(records: Sequence[Any]) -> dict[str, Any]:
    """Network evaluations in all, and of the cheapest and the most expensive frame."""
    spent = [record.facts["nfe"] for record in records if "nfe" in record.facts]
    if not spent:
        return {}
    return {"total": round(sum(spent)), "least": round(min(spent)), "most": round(max(spent)), "frames": len(spent)}


def _tasks(session: Session) -> list[dict[str, Any]]:
    """When each finished task of the last run began and ended, and in which process (0: not known)."""
    tasks: list[dict[str, Any]] = []
    if not session.output.events.exists():
        return tasks
    for line in session.output.events.read_text().splitlines():
        event = json.loads(line)
        if event["event"] == "cluster":
            tasks = []
        elif event["event"] == "done":
            end = event["time"]
            row = find_stage(StageId.parse(event["stage"]).name)
            if row is None:
                continue  # of another version of the product
            span = {"stage": row.name, "frame": event["frames"][0], "worker": event.get("pid", 0)}
            tasks.append(span | {"begin": end - event["seconds"], "end": end})
    return tasks
