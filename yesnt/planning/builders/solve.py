"""Nodes of the temporal solver: blocks, joint sweeps, and the joining of bands of rows to whole frames."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from yesnt.core.blocks import Block, Span
from yesnt.core.stage_id import StageId
from yesnt.planning import settings as of
from yesnt.planning.builders.assemble import ids, node_fields, node_keys
from yesnt.planning.builders.confidence import observations
from yesnt.planning.chunks import ROUND
from yesnt.planning.graph import Graph, Node, NodeId
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import CONFIDENCE, SOLVE
from yesnt.planning.task_records import Gaps, JoinBandsTask, SolveBlockTask, SolveJointlyTask


def solve_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """All sweeps of the shot's blocks in order, and whole frames at the end."""
    builder, exchange = _SolveBuilder(plan, graph), plan.exchange
    for sweep in range(1 + exchange.sweeps):
        if exchange.is_joint(sweep):
            yield builder.joint(sweep)
        yield from (builder.block(sweep, chunk, band) for chunk, band in exchange.solved(sweep))
    if not (plan.chunks.whole or exchange.ends_jointly):
        yield from (builder.join(chunk) for chunk in exchange.blocks)


class _SolveBuilder:
    """Makes the solver's nodes of one shot; what all blocks of a chunk need is found once."""

    def __init__(self, plan: ShotPlan, graph: Graph) -> None:
        self._plan, self._graph, self._exchange = plan, graph, plan.exchange
        self._frames, self._bands = plan.job.frames, tuple(band.index for band in plan.chunks.bands)
        temporal = changed_keys(plan.job.shot.temporal)
        self._settings = shared(
            energy=changed_fields(of.energy_params(plan.job.shot)),
            temporal={name: temporal[name] for name in ("enabled", "method", "tolerance") if name in temporal},
        )
        self._read = lru_cache(maxsize=2)(self._read_by)  # the bands of a chunk read the same

    def block(self, sweep: int, chunk: Block, band: Block) -> Node:
        """One block of one sweep; after sweep 0 it takes its border from the sweeps before."""
        exchange, chunks = self._exchange, self._plan.chunks
        loaded = exchange.loaded(chunk, sweep)
        last = exchange.last_solve(chunk.index, band.index, sweep)
        compared = (k for k in (sweep, last) if k > 0)  # sweep 0 reads observations only
        held = self._held(loaded, chunks.touched(band, sweep), *compared)
        own = {
            "chunk": [chunk.core.start, chunk.core.stop, chunk.outer.start, chunk.outer.stop],
            "band": None if chunks.whole else [*_flat(band), chunks.reach],
        }
        stage = exchange.stage(chunk.index, band.index, sweep)
        gaps = self._gaps(loaded)
        fields, needs = self._depends(stage, sweep, loaded, held, gaps, own)
        task = SolveBlockTask(exchange, sweep, gaps, chunk.index, band.index)
        core = tuple(self._frames[p] for p in chunk.core)
        return Node(stage, chunk.index, core, fields, needs, task, transient=stage != SOLVE)

    def joint(self, sweep: int) -> Node:
        """What the exchanges of a round left unconverged, in all frames together."""
        everything = range(len(self._frames))
        held = self._held(everything, self._bands, sweep, sweep - ROUND + 1)
        own = {"joint": self._plan.chunks.joint, "reach": self._plan.chunks.reach}
        stage, gaps = self._exchange.stage(0, 0, sweep), self._gaps(everything)
        fields, needs = self._depends(stage, sweep, everything, held, gaps, own)
        task = SolveJointlyTask(self._exchange, sweep, gaps)
        return Node(stage, 0, self._frames, fields, needs, task, transient=stage != SOLVE)

    def join(self, chunk: Block) -> Node:
        """The whole frames of a chunk that was solved in bands."""
        sweep = 1 + self._exchange.sweeps
        needs = self._held(range(chunk.core.start, chunk.core.stop), self._bands, sweep)
        fields = node_fields(self._plan, SOLVE, shared(joined=len(self._bands)), node_keys(needs))
        core = tuple(self._frames[p] for p in chunk.core)
        return Node(SOLVE, chunk.index, core, fields, ids(needs), JoinBandsTask(self._exchange, sweep, Gaps()))

    def _depends(
        self, stage: StageId, sweep: int, loaded: range, held: list[Node], gaps: Gaps, own: dict[str, Any]
    ) -> tuple[dict[str, Any], tuple[NodeId, ...]]:
        """Fields and needs of a solve: settings, observations, and the values of earlier sweeps."""
        read, keys = self._read(loaded)
        own = {**own, "sweep": sweep, "absent": sorted(gaps.absent)}
        fields = node_fields(self._plan, stage, self._settings, keys | node_keys(held), **own)
        return fields, read + ids(held)  # observations and earlier sweeps have no node in common

    def _read_by(self, loaded: range) -> tuple[tuple[NodeId, ...], dict[str, str]]:
        """Nodes of observations and confidence of these positions, and their keys."""
        chunks = self._plan.confidence_chunks
        numbers = range(chunks.index_of(loaded[0]), 1 + chunks.index_of(loaded[-1]))
        nodes = observations(self._plan, self._graph, Span(loaded.start, loaded.stop))
        nodes += [self._graph.nodes[CONFIDENCE, number] for number in numbers]
        return ids(nodes), node_keys(nodes)

    def _held(self, loaded: range, bands: tuple[int, ...], *sweeps: int) -> list[Node]:
        """Nodes that hold the last value of these positions and bands before each of the sweeps."""
        exchange, found = self._exchange, dict[NodeId, Node]()
        first, last = (exchange.blocks.index_of(p) for p in (loaded[0], loaded[-1]))
        for sweep in sweeps:
            for chunk in range(first, last + 1):
                for stage in exchange.before(chunk, bands, sweep).values():
                    node = self._graph.nodes[stage, exchange.index_of(stage, chunk)]
                    found[node.id] = node
        return list(found.values())

    def _gaps(self, loaded: range) -> Gaps:
        return self._plan.gaps.among(self._frames[p] for p in loaded)


def _flat(band: Block) -> list[int]:
    return [band.index, band.core.start, band.core.stop, band.outer.start, band.outer.stop]
