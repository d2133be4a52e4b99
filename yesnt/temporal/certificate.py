"""Lower bounds on the minimum of the temporal energy: the certificate on which a solver stops.

Write F(x) = sum_p c H(x - o) + sum_k phi_k(K_k x), with K the differences in space and along the flow. For any duals y
in the domain of phi*, Fenchel's inequality gives phi_k(K_k x) >= <y_k, K_k x> - phi_k*(y_k). With m = K^T y,

    F(x) >= - sum_k phi_k*(y_k) + sum_p min over x_p in [low, high] of  c H(x_p - o_p) + m_p x_p       (1)

for every x in the box. The spatial duals are y = lambda1 q, |q| <= 1, with -phi*(y) = lambda1 eps sqrt(1 - |q|^2); the
temporal duals are y = 2 lambda2 V e with phi*(y) = lambda2 V e^2. Where |m| <= c delta, the minimum of a pixel does not
depend on the box. Elsewhere, mainly at pixels of confidence 0, where no dual is strictly feasible in floating point,
the box keeps the bound finite: it costs |excess| times the width of the box.

The box is the range of the observed values, widened by its own width on both sides. It grows whenever a value comes
near its sides; earlier bounds are then discarded. A minimiser outside the box would, by convexity of F, lie below (1)
by at most the gap times the ratio of its distance to the margin of the box around the value.
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201, ANN202

from __future__ import annotations

import math

import numpy as np

from yesnt.temporal.geometry import FIXED, HAS_DOWN, HAS_RIGHT
from yesnt.temporal.kernels import kernel
from yesnt.temporal.stencils import ONE, add_warp_adjoint, has_links, pixels_of, stencil, warp_residual

FLAT = 0.9
"""Largest |q|^2 at which the edge between two pixels takes excess. Above it, at edges of the material, a change of q
costs up to |D x|; below it costs eps times its square. Of 0.5 to 0.95, 0.9 gave the smallest gap."""


@stencil
def _pixel_minimum(m, c, o, delta, low, high):
    """Minimum over [low, high] of c H(x - o) + m x, or a lower bound on it; exact for low = high."""
    c = np.float64(c)
    if low < high and abs(m) <= c * delta:
        return m * o - (0.5 * m * m / c if c > 0 else 0.0)
    x = low if m > 0 else high
    r = abs(x - o)
    return m * x + c * (0.5 * r * r if r <= delta else delta * (r - 0.5 * delta))


@stencil
def _add_duals(t, x, duals, out, geometry, lambda1, coupling):
    """Adds lambda1 D^T q of frame t, and the part of its links' B^T y that lies in frame t."""
    from_left = 0.0
    linked = has_links(t, geometry)
    for p in pixels_of(t, geometry):
        to_right = lambda1 * duals.qx[p] if geometry.flags[p] & HAS_RIGHT else 0.0
        to_down = lambda1 * duals.qy[p] if geometry.flags[p] & HAS_DOWN else 0.0
        out[p] += from_left - to_right - to_down
        from_left = to_right
        if geometry.flags[p] & HAS_DOWN:
            out[geometry.down[p]] += to_down
        if linked:
            out[p] -= coupling * geometry.link[p] * warp_residual(p, x, geometry)


@stencil
def _feasible(m, r, limit, delta):
    """The part of m that the data term of a pixel with residual r can balance, in [-limit, limit] with limit = c delta.

    In the linear part of the Huber function it is the whole limit: what is missing there costs |r| - delta per unit,
    first order, as an excess does.
    """
    if abs(r) > delta:
        return -limit if r > 0 else limit
    return min(limit, max(-limit, m))


@stencil
def _pass_on(excess, q, other, to, out, lambda1, most):
    """Moves a pixel's excess to the pixel `to` by a change of the dual q of their edge, within |q|^2 <= most.

    Returns:
        The new q and the excess that remains.
    """
    room = math.sqrt(max(0.0, most - other * other))
    new = min(room, max(-room, q + excess / lambda1))
    moved = lambda1 * (new - q)
    if moved * excess <= 0.0 or abs(q) > room:
        return q, excess
    out[to] += moved
    return new, excess - moved


@kernel
def dual_value(x, duals, out, energy, box):
    """Bound (1): a lower bound on F over the box.

    `x` [N] gives the temporal duals and the values of fixed pixels, `duals` the spatial ones; `out` [N] is scratch. Any
    duals give a bound, and one pass improves them while it computes the bound. The excess of a pixel is the part of its
    m that its data term cannot balance. It is moved to the right, down or along the flow by changing the duals of that
    edge; at a pixel within its limit this costs little. An edge with |q|^2 > FLAT is used only for a pixel without a
    link whose |m| exceeds its limit. The pass visits all frames in order, whatever the number of threads.
    """
    geometry, observed, confidence = energy.geometry, energy.observed, energy.confidence
    delta, lambda1, lambda2, eps = energy.delta, energy.lambda1, energy.lambda2, energy.eps
    total = 0.0
    out[:] = 0.0
    for t in range(len(geometry.frames) - 1):
        _add_duals(t, x, duals, out, geometry, lambda1, 2.0 * lambda2)
        linked = has_links(t, geometry) and lambda2 > 0
        for p in pixels_of(t, geometry):
            fixed = geometry.flags[p] & FIXED
            limit, link = confidence[p] * delta, linked and geometry.link[p] > 0
            kept = out[p] if fixed else _feasible(out[p], x[p] - np.float64(observed[p]), limit, delta)
            excess = out[p] - kept
            u = np.float64(duals.qx[p]) if geometry.flags[p] & HAS_RIGHT else 0.0
            v = np.float64(duals.qy[p]) if geometry.flags[p] & HAS_DOWN else 0.0
            if excess != 0.0 and lambda1 > 0:
                most = FLAT if link or abs(out[p]) <= limit else 1.0
                if geometry.flags[p] & HAS_RIGHT:
                    u, excess = _pass_on(excess, u, v, p + ONE, out, lambda1, most)
                if geometry.flags[p] & HAS_DOWN:
                    v, excess = _pass_on(excess, v, u, np.uint64(geometry.down[p]), out, lambda1, most)
            total += lambda1 * eps * math.sqrt(max(0.0, 1.0 - u * u - v * v))
            if link:
                flux = 2.0 * lambda2 * geometry.link[p] * warp_residual(p, x, geometry) + excess
                excess = 0.0
                total -= flux * flux / (4.0 * lambda2 * geometry.link[p])
                add_warp_adjoint(p, flux, out, geometry)
            low, high = (x[p], x[p]) if fixed else (box.low, box.high)
            total += _pixel_minimum(kept + excess, confidence[p], np.float64(observed[p]), delta, low, high)
    return total
