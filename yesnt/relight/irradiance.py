"""Irradiance from clusters: above the horizon the clamped cosine is linear, so a cluster's first moment is exact.

One that the horizon cuts passes it as an even square of its light's variance would (66 dB or more to the full sum with
256 clusters), or is left to its texels.
"""

from __future__ import annotations

import numpy as np

from yesnt.relight.compiled import inlined, kernel

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)


@kernel
def clamped_cosine(moment, edge, behind, frame, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the irradiance, and that of white, of clusters that pass the horizon as even squares: PreparedLight.edge."""
    nx, ny, nz = frame[0], frame[1], frame[2]
    red = green = blue = white = _ZERO
    for c in range(behind.shape[0]):
        on = _ONE if behind[c] == 0 else _ZERO
        red += on * _clamped(moment[0, c] * nx + moment[1, c] * ny + moment[2, c] * nz, edge[0, c], edge[4, c])
        green += on * _clamped(moment[3, c] * nx + moment[4, c] * ny + moment[5, c] * nz, edge[1, c], edge[5, c])
        blue += on * _clamped(moment[6, c] * nx + moment[7, c] * ny + moment[8, c] * nz, edge[2, c], edge[6, c])
        white += on * _clamped(moment[9, c] * nx + moment[10, c] * ny + moment[11, c] * nz, edge[3, c], edge[7, c])
    out[0] += red
    out[1] += green
    out[2] += blue
    out[16] += white


@inlined
def _clamped(mean, half, over):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The mean of max(x, 0) for x even on mean - half to mean + half, `over` being 1 / (2 sqrt(half))."""
    part = min(max(mean + half, _ZERO), half + half) * over
    return part * part + max(mean - half, _ZERO)


@kernel
def above_the_horizon(cone, moment, facing, behind, frame, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds the irradiance, and that of white, of clusters wholly above the horizon."""
    r0 = r1 = r2 = g0 = g1 = g2 = b0 = b1 = b2 = w0 = w1 = w2 = _ZERO
    for c in range(facing.shape[0]):
        on = _ONE if behind[c] == 0 and facing[c] > cone[3, c] else _ZERO
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
    nx, ny, nz = frame[0], frame[1], frame[2]
    out[0] += r0 * nx + r1 * ny + r2 * nz
    out[1] += g0 * nx + g1 * ny + g2 * nz
    out[2] += b0 * nx + b1 * ny + b2 * nz
    out[16] += w0 * nx + w1 * ny + w2 * nz
