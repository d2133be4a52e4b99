"""Lower bounds on the minimum of the temporal energy: the certificate that a solver stops on.

Write F(x) = sum_p c H(x - o) + sum_k phi_k(K_k x) with K the differences in space and along the flow. For any
duals y in the domain of phi*, Fenchel's inequality gives phi_k(K_k x) >= <y_k, K_k x> - phi_k*(y_k); so with m = K^T y,

    F(x) >= - sum_k phi_k*(y_k) + sum_p min over x_p in [low, high] of  c H(x_p - o_p) + m_p x_p       (1)

for every x in the box. The spatial duals are y = lambda1 q, |q| <= 1, with -phi*(y) = lambda1 eps sqrt(1 - |q|^2); the
temporal ones are y = 2 lambda2 V e with phi*(y) = lambda2 V e^2. Where |m| <= c delta the pixel's minimum does not feel
the box. Elsewhere, above all at pixels of confidence 0, where no dual is strictly feasible in floating point, the box
makes the bound finite: it costs |excess| times the box's width instead of infinity.

The box is the range of what was observed, widened by its own width on both sides, and it grows whenever a value comes
near its sides (the bounds found before are then dropped). A minimiser outside the box would by convexity of F lie below
(1) at most by the gap times the ratio of its distance to the box's margin around the value.
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201, ANN202

from __future__ import annotations

import math

import numpy as np
from numba import njit

from yesnt.temporal.geometry import FIXED, HAS_DOWN, HAS_RIGHT
from yesnt.temporal.kernels import ONE, has_links, link_residual, pixels_of, scatter_next

FLAT = 0.9
"""Largest |q|^2 up to which an edge takes what another pixel has too much of: beyond, at the edges of the material, a
change of q costs up to |D x|, elsewhere eps times its square. (0.5 to 0.95 measured: 0.9 gives the smallest gap.)"""


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
def _add_duals(t, x, qx, qy, out, geo, lambda1, coupling):
    """Adds D^T lambda1 q of frame t, and of its links the part that falls on frame t."""
    from_left = 0.0
    linked = has_links(t, geo)
    for p in pixels_of(t, geo):
        to_right = lambda1 * qx[p] if geo.flags[p] & HAS_RIGHT else 0.0
        to_down = lambda1 * qy[p] if geo.flags[p] & HAS_DOWN else 0.0
        out[p] += from_left - to_right - to_down
        from_left = to_right
        if geo.flags[p] & HAS_DOWN:
            out[geo.down[p]] += to_down
        if linked:
            out[p] -= coupling * geo.link[p] * link_residual(p, x, geo)


@njit(cache=True)
def _wanted(m, r, limit, delta):
    """The data term's dual that pixel p should answer: m within c delta; where the residual r is saturated, all of it.

    There the pixel's minimum is worth |r| - delta for every bit that is missing: first order, as an excess is.
    """
    if abs(r) > delta:
        return -limit if r > 0 else limit
    return min(limit, max(-limit, m))


@njit(cache=True)
def _pass_on(p, excess, q, other, to, out, lambda1, most):
    """Gives pixel p's excess to the pixel `to` through the dual q of the edge between them, as far as |q|^2 <= most.

    Returns:
        The new q and the excess that is left.
    """
    room = math.sqrt(max(0.0, most - other * other))
    new = min(room, max(-room, q + excess / lambda1))
    moved = lambda1 * (new - q)
    if moved * excess <= 0.0 or abs(q) > room:
        return q, excess
    out[to] += moved
    return new, excess - moved


@njit(cache=True, nogil=True)
def dual_value(x, qx, qy, out, geo, observed, confidence, params, box):
    """Bound (1): a lower bound on F over the box.

    `x` [N] gives the temporal duals (and the values of fixed pixels), `qx`, `qy` [N] in the unit disc the spatial ones;
    `box` is (low, high); `out` [N] is scratch. One pass repairs the duals on its way: what m has too much of, or too
    little, is handed to the right, down, or along the flow, since a pixel with room takes it at a cost of second order.
    Edges that have hardly room themselves (|q|^2 > FLAT) take it only where no link does and m is too large. Any duals
    give a bound, so the repair needs no proof. It runs through all frames in order, whatever the threads.
    """
    delta, lambda1, lambda2, eps = params
    total = 0.0
    out[:] = 0.0
    for t in range(len(geo.frames) - 1):
        _add_duals(t, x, qx, qy, out, geo, lambda1, 2.0 * lambda2)
        linked = has_links(t, geo) and lambda2 > 0
        for p in pixels_of(t, geo):
            fixed = geo.flags[p] & FIXED
            limit, link = confidence[p] * delta, linked and geo.link[p] > 0
            kept = out[p] if fixed else _wanted(out[p], x[p] - np.float64(observed[p]), limit, delta)
            excess = out[p] - kept
            u = np.float64(qx[p]) if geo.flags[p] & HAS_RIGHT else 0.0
            v = np.float64(qy[p]) if geo.flags[p] & HAS_DOWN else 0.0
            if excess != 0.0 and lambda1 > 0:
                most = FLAT if link or abs(out[p]) <= limit else 1.0
                if geo.flags[p] & HAS_RIGHT:
                    u, excess = _pass_on(p, excess, u, v, p + ONE, out, lambda1, most)
                if geo.flags[p] & HAS_DOWN:
                    v, excess = _pass_on(p, excess, v, u, geo.down[p], out, lambda1, most)
            total += lambda1 * eps * math.sqrt(max(0.0, 1.0 - u * u - v * v))
            if link:
                flux = 2.0 * lambda2 * geo.link[p] * link_residual(p, x, geo) + excess
                excess = 0.0
                total -= flux * flux / (4.0 * lambda2 * geo.link[p])
                scatter_next(p, flux, out, geo)
            low, high = (x[p], x[p]) if fixed else box
            total += _pixel_minimum(kept + excess, confidence[p], np.float64(observed[p]), delta, low, high)
    return total
