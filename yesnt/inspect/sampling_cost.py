"""Sampling cost: the number of function evaluations (NFE) of the network that a run needs, from mattes and patches."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from yesnt.core.shot import Job
from yesnt.decompose import blend
from yesnt.decompose.blend import PatchGrid
from yesnt.io.file_digests import file_digest
from yesnt.io.record_index import RecordIndex
from yesnt.io.records import digest_of
from yesnt.io.shot_inputs import read_matte
from yesnt.planning import settings as of
from yesnt.planning.graph import Graph, Node, NodeId
from yesnt.planning.task_records import DecomposeTask
from yesnt.runtime.checks.inputs import code_digest
from yesnt.runtime.session import Session

TYPICAL_SHARE = {"full": 0.35, "between": 0.1}
"""Share of all members that a frame sampled in full, and one between keyframes, needs where a tolerance is set.
A guess for a job's first run, not a measurement; once frames are done, their records replace it."""


@dataclass(frozen=True)
class SamplingCost:
    """Network evaluations (NFE) of the frames that are not done yet.

    Attributes:
        least: if every patch stops after its first members, and frames between keyframes sample nothing.
        expected: by the measured share of this job's frames that are done, or else the typical share.
        most: if every patch samples all members that its tolerance can require.
        fixed: of all frames of the shot with all members.
        samples: that number of members.
        basis: where `expected` comes from.
    """

    least: int
    expected: int
    most: int
    fixed: int
    samples: int
    basis: str


def sampling_cost(session: Session, graph: Graph, index: RecordIndex | None = None) -> SamplingCost:
    """Counts patches that see the matte, for every frame (or window) that is to be sampled."""
    plan = session.plan()
    settings = of.ensemble_settings(session.job.shot)
    if plan.backend is None:
        return SamplingCost(0, 0, 0, 0, settings.samples, "passes are read")
    nodes = [node for node in graph if node.stage.name == ("window" if plan.windows else "decompose")]
    print_of, index = plan.backend.footprint, index or session.open_index()
    patches = _all_patches(session, nodes, (print_of.patch, print_of.align, settings.overlap))
    users = graph.users()
    todo = [node for node in nodes if not _settled(index, node, [graph.nodes[user] for user in users[node.id]])]
    members = settings.rounds()[0].stop
    least, most, expected = 0.0, 0.0, 0.0
    at_most = members if print_of.predicts_mean else settings.samples  # without a tolerance both are the same
    shares, basis = _shares(index, nodes, patches, print_of.nfe * at_most)
    for node in todo:
        one = patches[node.id] * print_of.nfe
        between = _between(node)
        least += 0 if between else one * members
        most += one * at_most
        open_ended = between or members < at_most
        expected += one * at_most * (shares["between" if between else "full"] if open_ended else 1)
    fixed = sum(patches.values()) * print_of.nfe * settings.samples
    return SamplingCost(round(least), round(expected), round(most), fixed, settings.samples, basis)


def is_indexed(index: RecordIndex, node: Node) -> bool:
    """Whether every frame of a node is done, by the index."""
    return all(index.done(node.stage, frame, node.frame_key(frame)) for frame in node.frames)


def _settled(index: RecordIndex, node: Node, users: Sequence[Node]) -> bool:
    """Whether a node need not run: it is done, or its users are and its own result has been removed."""
    served = node.transient and bool(users) and all(is_indexed(index, user) for user in users)
    return served or is_indexed(index, node)


def _between(node: Node) -> bool:
    """Whether a frame takes a keyframe's estimate."""
    return isinstance(node.task, DecomposeTask) and node.task.keyframe is not None


def _all_patches(session: Session, nodes: Sequence[Node], cut: tuple[int | None, int, float]) -> dict[NodeId, int]:
    """Node -> patches that see any matte. Counting decodes the plates, so a count is remembered by their digests."""
    job, facts = session.job, session.checks.facts
    code = [code_digest(), file_digest(Path(blend.__file__))]
    plan = session.plan()
    form = {"patches": cut, "window": str(job.window), "plate": plan.plate_settings, "code": code}
    found = {}
    for node in nodes:
        plates = [plan.plate_inputs(frame) for frame in node.frames]
        found[node.id] = facts.fetch(digest_of({**form, "plates": plates}), partial(_patches, job, node, *cut))
    return found


def _patches(job: Job, node: Node, patch: int | None, align: int, overlap: float) -> int:
    """Patches of a frame, or of a window's frames together, that see any matte."""
    matte = np.maximum.reduce([read_matte(job, frame) for frame in node.frames])
    if patch is None:
        return int(matte.any())
    grid = PatchGrid.cover(job.height, job.width, patch, overlap, align)
    padded = np.pad(matte, ((0, grid.height - job.height), (0, grid.width - job.width)))
    return len(grid.covering(padded))


def _shares(
    index: RecordIndex, nodes: Sequence[Node], patches: dict[NodeId, int], whole: int
) -> tuple[dict[str, float], str]:
    """Share of all members that frames drawn in full, and frames between keyframes, spend."""
    spent: dict[str, list[float]] = {"full": [], "between": []}
    for node in nodes:
        entry = index.find(node.stage, node.frames[0])
        if entry is not None and entry.nfe is not None and patches[node.id]:
            kind = "between" if _between(node) else "full"
            spent[kind].append(entry.nfe / (patches[node.id] * whole))
    shares = {kind: statistics.mean(found) if found else TYPICAL_SHARE[kind] for kind, found in spent.items()}
    return shares, "measured on this job's frames" if any(spent.values()) else "typical share of a first run"
