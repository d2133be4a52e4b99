"""Measures one frame of a shot: numbers that say whether its inputs agree, as a JSON value."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from yesnt.core.camera import Camera
from yesnt.core.shot import GBufferInput, Job
from yesnt.io import shot_inputs
from yesnt.io.mesh import read_proxy
from yesnt.relight import EnvMap, ProxyScene
from yesnt.runtime.checks.consistency import exposure, proxy
from yesnt.runtime.checks.consistency.feet import feet
from yesnt.runtime.checks.consistency.geometry import agreement, hypotheses, ray_share, steepness
from yesnt.runtime.checks.consistency.sample import GOOD, LEAST, SLOPES, Sample, take_sample
from yesnt.tasks.light import frame_map


def measure_frame(job: Job, frame: int, camera: Camera) -> dict[str, Any]:
    """Facts of a frame; empty where it has too few covered pixels to conclude anything.

    Keys: `zero`, `unit`, `facing`, `along` (shares), `mends` (what mends normals: share), `ray`, `ray_gain`, `steep`
    (slope of depth over that of the normals), `extent` (metres), `bright` (share), `albedo` (median, 99th percentile),
    `proxy` (hit, agree, ratio, degenerate, mends, contact, height).
    """
    plate, surface = shot_inputs.read_plate(job, frame, working=True), shot_inputs.read_surface(job, frame, camera)
    sample = take_sample(camera, frame, plate, surface)
    if len(sample.z) < LEAST:
        return {}
    facts = _normals(sample, job.shot.gbuffer)
    share, gain = ray_share(sample)
    facts |= {"ray": _known(share), "ray_gain": gain, "steep": _known(steepness(sample)), "extent": sample.extent}
    spec = job.shot.capture_light
    estimated = spec is not None and spec.path is None
    facts |= _brightness(sample, frame_map(job, None if estimated else spec, frame))
    if job.shot.proxy is not None and (sample.z > 0).sum() >= LEAST:
        mesh = read_proxy(job, frame)
        facts["proxy"] = _proxy(ProxyScene.from_arrays(mesh.vertices, mesh.faces), sample)
    return facts


def _normals(sample: Sample, spec: GBufferInput) -> dict[str, Any]:
    length = np.linalg.norm(sample.normal, axis=1)
    found = agreement(sample, sample.normal)
    facts: dict[str, Any] = {
        "zero": float((length < 1e-3).mean()), "unit": float(((length > 0.5) & (length < 1.05)).mean()),
        "facing": _known(found.facing), "along": _known(found.along), "mends": {},
    }  # fmt: skip
    if found.facing < GOOD or found.along < SLOPES:
        tried = {mend: agreement(sample, normal) for mend, normal in hypotheses(sample, spec).items()}
        facts["mends"] = {mend: [one.share, one.misfit] for mend, one in tried.items()}
    return facts


def _known(value: float) -> float | None:
    """The value, None where it is not finite: JSON has no such number."""
    return value if math.isfinite(value) else None


def _brightness(sample: Sample, light: EnvMap) -> dict[str, Any]:
    albedo = exposure.implied_albedo(sample, light)
    if not len(albedo):
        return {}
    return {"bright": float((albedo > 1).mean()), "albedo": [float(v) for v in np.percentile(albedo, (50, 99))]}


def _proxy(scene: ProxyScene, sample: Sample) -> dict[str, Any]:
    degenerate = proxy.degenerate_share(scene)
    found = proxy.compare(scene, sample)
    mends = proxy.hypotheses(scene, sample) if found.agree < GOOD and degenerate < 1 else {}
    return {
        "hit": found.hit,
        "agree": found.agree,
        "ratio": _known(found.ratio),
        "degenerate": degenerate,
        "mends": mends,
        **feet(scene),
    }
