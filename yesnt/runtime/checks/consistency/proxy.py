"""The proxy mesh against depth: does each pixel's ray meet it where depth says the surface is?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera_axes import UNITS
from yesnt.relight import ProxyScene
from yesnt.runtime.checks.consistency.sample import Sample

F64 = NDArray[np.float64]

NEAR = 0.03
"""Difference of proxy and depth, of the depth, within which they agree: 10 cm of an actor 3 m away."""

_Z_UP_TO_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@dataclass(frozen=True)
class ProxyAgreement:
    """How a proxy fits depth.

    Attributes:
        hit: share of pixels whose ray meets the proxy.
        agree: share of pixels whose ray meets it within `NEAR` of their depth.
        ratio: median of the proxy's depth over the pixel's, where rays meet it; NaN if none does.
    """

    hit: float
    agree: float
    ratio: float


def compare(scene: ProxyScene, sample: Sample, scale: float = 1.0, turn: F64 | None = None) -> ProxyAgreement:
    """Traces the sample's rays.

    Args:
        scene: the proxy, in metres of the world.
        sample: pixels; those without a depth are left out.
        scale: metres of one unit of the proxy.
        turn: [3, 3] from the world's axes to the proxy's; None: they are the same.
    """
    known = sample.z > 0
    turn = np.eye(3) if turn is None else turn
    rays = sample.ray[known] @ sample.pose[:3, :3].T @ turn.T
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    eye = np.broadcast_to(turn @ sample.pose[:3, 3] / scale, rays.shape)
    found = scene.trace(eye.astype(np.float32), (rays / length).astype(np.float32))
    hit = found["primID"].astype(np.int64) >= 0
    ratio = found["tfar"].astype(np.float64)[hit] / length[hit, 0] * scale / sample.z[known][hit]
    near = float((np.abs(ratio - 1) < NEAR).sum()) / max(len(hit), 1)
    return ProxyAgreement(float(hit.mean()), near, float(np.median(ratio)) if hit.any() else float("nan"))


def degenerate_share(scene: ProxyScene) -> float:
    """Share of the faces without an area."""
    a, b, c = (scene.vertices[scene.faces[:, i]].astype(np.float64) for i in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1)) ** 2
    return float((doubled <= 1e-9 * longest).mean())


def hypotheses(scene: ProxyScene, sample: Sample) -> dict[str, tuple[float, float]]:
    """Share of agreeing and of other pixels after one usual mistake is mended, by what mends it."""
    found = {
        f"the job said `units: {unit}` of the proxy": compare(scene, sample, UNITS[unit]).agree for unit in ("cm", "mm")
    }
    for factor in (100, 1000):
        found[f"the proxy were {factor} times as large"] = compare(scene, sample, factor).agree
    found["the job said `up: y` of the proxy"] = compare(scene, sample, 1, _Z_UP_TO_Y_UP).agree
    for unit, scale in (("cm", 0.01), ("mm", 0.001)):
        found[f"the job said `units: {unit}` of the G-buffer"] = compare(scene, sample.scaled(scale)).agree
    return {mend: (share, 1 - share) for mend, share in found.items()}
