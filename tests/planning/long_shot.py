"""A shot of any length as a plan, without files: planning reads nothing but digests."""

from __future__ import annotations

from collections import defaultdict

from yesnt.core.material_input import DecomposeInput
from yesnt.core.shot import GBufferInput, Job, LightInput, PlateInput, ProxyInput, Shot, TemporalInput
from yesnt.planning.chunks import Extent, plan_chunks
from yesnt.planning.shot_plan import ShotPlan
from yesnt.temporal import EnergyParams


def long_plan(frames: int, size: tuple[int, int] = (64, 48), step: int = 1, **temporal) -> ShotPlan:
    """A plan of `frames` frames with all kinds of inputs; its files are said to have the digest "d"."""
    shot = Shot(
        version=1, name="long", frames="1", camera="camera.json",
        plate=PlateInput(path="plate.####.exr"), gbuffer=GBufferInput(path="gbuffer.####.exr"),
        light=LightInput(path="light.exr"), proxy=ProxyInput(path="proxy.####.ply"),
        decompose=DecomposeInput(path="material.####.exr"), temporal=TemporalInput(**temporal),
    )  # fmt: skip
    width, height = size
    numbers = tuple(1001 + step * i for i in range(frames))
    job = Job(shot=shot, root="/shot", frames=numbers, width=width, height=height)
    chunks = plan_chunks(EnergyParams(), shot.temporal, 1e-4, frames, Extent(height, width, 0.4))
    return ShotPlan(job, defaultdict(lambda: "d"), None, chunks)
