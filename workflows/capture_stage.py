"""The virtual capture stage: every job of every set, and the sets that build on another after it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from yesnt.capture_stage.jobs import render_jobs
from yesnt.capture_stage.reference import of_fits
from yesnt.core.stage_id import StageId
from yesnt.planning.graph import Graph, Node
from yesnt.planning.task_records import RenderTask

RENDER = StageId("render")

BUILDS_ON = {"reference": "objects"}
"""The reference row relights the proxy meshes that the objects set leaves."""


def capture_stage_graph(set_names: Sequence[str], small: bool, fits: Path | None = None) -> Graph:
    """One node a render job; with the folder of an evaluation the references of the meshes that were fitted there."""
    ordered = sorted(dict.fromkeys(set_names), key=lambda name: name in BUILDS_ON)
    jobs = [job for name in ordered for job in render_jobs(name, small)]
    jobs = jobs if fits is None else list(of_fits(jobs, fits))
    first = {(job.set_name, job.subject): i for i, job in reversed(list(enumerate(jobs)))}
    nodes = []
    for i, job in enumerate(jobs):
        base = first.get((BUILDS_ON.get(job.set_name, ""), job.subject))
        needs = () if base is None else ((RENDER, base),)
        # A record is named by its job, so that a set keeps its records whichever other sets are rendered.
        nodes.append(Node(RENDER, i, (int(job.key[:12], 16),), {"job": job.key}, needs, RenderTask(job)))
    return Graph(nodes)
