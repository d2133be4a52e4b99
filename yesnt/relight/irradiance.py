"""Irradiance from light clusters instead of texels.

Above the horizon the clamped cosine is linear in the direction, so the first moment of a cluster gives its irradiance
exactly. A cluster that the horizon cuts is taken for an even square of its light's variance (66 dB or more to the full
sum with 256 clusters), or is left to its texels.
"""

from __future__ import annotations

import numpy as np

from yesnt.relight.compiled import inlined, kernel
from yesnt.relight.shading_frame import load_frame

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)


@kernel
def add_clamped_clusters(moment, edge, hidden, stored_frame, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the irradiance of all visible clusters, each passing the horizon as an even square.

    Args:
        moment: [12, C] of PreparedLight.
        edge: [8, C] of PreparedLight.
        hidden: [C] uint8, 1 where the cluster is occluded.
        stored_frame: [12] ShadingFrame.
        sums: [20] lobe sums: irradiance and that of uniform white are added to.
    """
    n = load_frame(stored_frame).normal
    red = green = blue = white = _ZERO
    for c in range(hidden.shape[0]):
        on = _ONE if hidden[c] == 0 else _ZERO
        red += on * _clamped(moment[0, c] * n.x + moment[1, c] * n.y + moment[2, c] * n.z, edge[0, c], edge[4, c])
        green += on * _clamped(moment[3, c] * n.x + moment[4, c] * n.y + moment[5, c] * n.z, edge[1, c], edge[5, c])
        blue += on * _clamped(moment[6, c] * n.x + moment[7, c] * n.y + moment[8, c] * n.z, edge[2, c], edge[6, c])
        white += on * _clamped(moment[9, c] * n.x + moment[10, c] * n.y + moment[11, c] * n.z, edge[3, c], edge[7, c])
    sums[0] += red
    sums[1] += green
    sums[2] += blue
    sums[16] += white


@inlined
def _clamped(mean, half, over):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Mean of max(x, 0) for x uniform on [mean - half, mean + half]; `over` is 1 / (2 sqrt(half)), 0 for half 0."""
    part = min(max(mean + half, _ZERO), half + half) * over
    return part * part + max(mean - half, _ZERO)


@kernel
def add_clusters_above(cone, moment, state, stored_frame, sums):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the irradiance of visible clusters that lie wholly above the horizon.

    Args:
        cone: [4, C] of PreparedLight.
        moment: [12, C] of PreparedLight.
        state: ClusterState; `cosine` and `hidden` are read.
        stored_frame: [12] ShadingFrame.
        sums: [20] lobe sums: irradiance and that of uniform white are added to.
    """
    r0 = r1 = r2 = g0 = g1 = g2 = b0 = b1 = b2 = w0 = w1 = w2 = _ZERO
    for c in range(state.cosine.shape[0]):
        on = _ONE if state.hidden[c] == 0 and state.cosine[c] > cone[3, c] else _ZERO
        r0 += on * moment[0, c]
        r1 += on * moment[1, c]
        r2 += on * moment[2, c]
        g0 += on * moment[3, c]
        g1 += on * moment[4, c]
        g2 += on * moment[5, c]
        b0 += on * moment[6, c]
        b1 += on * moment[7, c]
        b2 += on * moment[8, c]
        w0 += on * moment[9, c]
        w1 += on * moment[10, c]
        w2 += on * moment[11, c]
    n = load_frame(stored_frame).normal
    sums[0] += r0 * n.x + r1 * n.y + r2 * n.z
    sums[1] += g0 * n.x + g1 * n.y + g2 * n.z
    sums[2] += b0 * n.x + b1 * n.y + b2 * n.z
    sums[16] += w0 * n.x + w1 * n.y + w2 * n.z
