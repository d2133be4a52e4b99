"""Runs a shot's nodes in the test's own process, in any order that the graph allows: no cluster to start."""

from __future__ import annotations

import hashlib
import random
from pathlib import Path

from yesnt.io.store import FrameStore
from yesnt.runtime.driver.driver import is_done
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node


def run_here(path: Path, until: str = "decompose", frames: str | None = None, order: int = 0) -> Session:
    """Runs what is not done; `order` seeds the choice among the nodes that are ready."""
    session, chance = Session(path), random.Random(order)
    plan, graph = session.plan(), session.graph()
    graph = graph.closure(session.targets(graph, RunOptions(frames, until)))
    session.book.keep_only(session.job.frames)
    FrameStore.create(session.output.store, plan.arrays(), session.job.frames, session.job.height, session.job.width)
    session.output.exr.mkdir(parents=True, exist_ok=True)
    waiting = [node for node in graph if not is_done(session.book, node)]
    while waiting:
        names = {node.id for node in waiting}
        node = chance.choice([node for node in waiting if names.isdisjoint(node.needs)])
        run_node(session.job, node)
        waiting.remove(node)
    return session


def shard_digests(session: Session, *arrays: str) -> dict[str, str]:
    """SHA-256 of every stored frame of the arrays."""
    store = session.output.store
    files = sorted(p for name in arrays for p in (store / name / "c").rglob("*") if p.is_file())
    return {str(p.relative_to(store)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
