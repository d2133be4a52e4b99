"""Lower bounds on the minimum of the temporal energy: the certificate that a solver stops on.

Write F(x) = sum_p c H(x - o) + sum_k phi_k(K_k x) with K the differences in space and along the flow. For any
duals y in the domain of phi*, Fenchel's inequality gives phi_k(K_k x) >= <y_k, K_k x> - phi_k*(y_k); so with m = K^T y,

    F(x) >= - sum_k phi_k*(y_k) + sum_p min over x_p in [low, high] of  c H(x_p - o_p) + m_p x_p       (1)

for every x in the box. The spatial duals are y = lambda1 q, |q| <= 1, with -phi*(y) = lambda1 eps sqrt(1 - |q|^2); the
temporal ones are y = 2 lambda2 V e with phi*(y) = lambda2 V e^2. Where |m| <= c delta the pixel's minimum does not feel
the box. Elsewhere, above all at pixels of confidence 0, where no dual is strictly feasible in floating point, the box
makes the bound finite: it costs |excess| times the box's width instead of infinity.

The box is the range of what was observed, widened by its own width on both sides. A minimiser outside it, which no
material can be, would by convexity of F lie below (1) at most by the gap times its distance over the box's width.
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201, ANN202

from __future__ import annotations

import math

import numpy as np
from numba import njit

from yesnt.temporal.geometry import FIXED, HAS_DOWN, HAS_RIGHT
from yesnt.temporal.kernels import links_from, links_into, pixels_of


@njit(cache=True)
def _pixel_minimum(m, c, o, delta, low, high):
    """Minimum over [low, high] of c H(x - o) + m x, or a lower bound on it; exact for low = high."""
    c = np.float64(c)
    if low < high and abs(m) <= c * delta:
        return m * o - (0.5 * m * m / c if c > 0 else 0.0)
    x = low if m > 0 else high
    r = abs(x - o)
    return m * x + c * (0.5 * r * r if r <= delta else delta * (r - 0.5 * delta))


@njit(cache=True)
def _space_dual(t, qx, qy, out, geo, lambda1, eps):
    """Adds D^T lambda1 q of frame t; returns - phi*."""
    total, from_left = 0.0, 0.0
    for p in pixels_of(t, geo):
        x = np.float64(qx[p]) if geo.flags[p] & HAS_RIGHT else 0.0
        y = np.float64(qy[p]) if geo.flags[p] & HAS_DOWN else 0.0
        total += math.sqrt(max(0.0, 1.0 - x * x - y * y))
        out[p] += from_left - lambda1 * (x + y)
        from_left = lambda1 * x
        if geo.flags[p] & HAS_DOWN:
            out[geo.down[p]] += lambda1 * y
    return lambda1 * eps * total


@njit(cache=True, nogil=True)
def dual_value(first, last, x, qx, qy, scratch, values, geo, observed, confidence, params, box):
    """Bound (1) per frame of first .. last - 1: `values` [T] sum to a lower bound on F over the box.

    `x` [N] gives the temporal duals (and the values of fixed pixels), `qx`, `qy` [N] in the unit disc the spatial ones;
    `box` is (low, high).
    """
    delta, lambda1, lambda2, eps = params
    scratch[geo.frames[first] : geo.frames[last]] = 0.0
    links_into(first, x, scratch, geo, 2.0 * lambda2)
    for t in range(first, last):
        total = _space_dual(t, qx, qy, scratch, geo, lambda1, eps)
        total -= lambda2 * links_from(t, x, scratch, geo, 2.0 * lambda2, t + 1 < last)
        for p in pixels_of(t, geo):
            low, high = (x[p], x[p]) if geo.flags[p] & FIXED else box
            total += _pixel_minimum(scratch[p], confidence[p], np.float64(observed[p]), delta, low, high)
        values[t] = total
