"""Kernels of the temporal energy on compact pixel lists: value and gradient, weights of a Newton step, its duals.

F(x) is the sum of three terms (docs/method.md section 4; reference.py is the NumPy reference):
    data   c H_delta(x - x~)         derivative  c delta u,            |u| <= 1
    space  lambda1 |(d, eps)|        derivative  lambda1 D^T q,        |q| <= 1,   d = (Dx x, Dy x)
    time   lambda2 V e^2             derivative  2 lambda2 B^T V e,                e = B x = W x_{t+1} - x_t

A kernel processes the frames first .. last - 1 and releases the interpreter lock; threads.py runs several at once. The
sums of a frame are always added in the same order, and reductions are per frame and in float64, so results do not
depend on the number of threads. `fastmath` is off for the same reason: the compiler may not reassociate sums.
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201, ANN202

from __future__ import annotations

import math

import numpy as np

from yesnt.core.compiled import compiled
from yesnt.temporal.geometry import FIXED, HAS_DOWN
from yesnt.temporal.stencils import (
    add_links_into,
    add_warp_adjoint,
    differences,
    has_links,
    pixels_of,
    stencil,
    warp_residual,
)

kernel = compiled(nogil=True, _nrt=False, no_cfunc_wrapper=True)
"""Decorator of kernels: they release the interpreter lock and create no arrays."""

BALL_MARGIN = 1.0 + 5e-7
"""Factor on |q| before it is projected into the unit ball: keeps |q| <= 1 after rounding to float32, as the certificate
needs."""


@stencil
def huber_derivative(r, delta):
    """H'_delta(r) = delta u: r, limited to [-delta, delta]."""
    return min(delta, max(-delta, r))


@stencil
def smoothed_length(dx, dy, eps):
    """Tau = sqrt(dx^2 + dy^2 + eps^2), the summand of the smoothed total variation."""
    return math.sqrt(dx * dx + dy * dy + eps * eps)


@kernel
def gradient(first, last, x, out, energies, energy):
    """Gradient [N] and value per frame [T] of F at x [N], float64; the gradient is 0 at fixed pixels."""
    geometry, lambda2 = energy.geometry, energy.lambda2
    out[geometry.frames[first] : geometry.frames[last]] = 0.0
    coupling = 2.0 * lambda2
    add_links_into(first, x, out, geometry, coupling)
    for t in range(first, last):
        value = _add_data_and_space(t, x, out, energy)
        energies[t] = value + lambda2 * _add_links(t, x, out, geometry, coupling, t + 1 < last)
        for p in pixels_of(t, geometry):
            if geometry.flags[p] & FIXED:
                out[p] = 0.0


@stencil
def _add_data_and_space(t, x, out, energy):
    """Adds the gradient of the data and the spatial term of frame t to `out`; returns their value."""
    geometry, confidence, lambda1 = energy.geometry, energy.confidence, energy.lambda1
    data, space, from_left = 0.0, 0.0, 0.0
    for p in pixels_of(t, geometry):
        r = x[p] - np.float64(energy.observed[p])
        slope = huber_derivative(r, energy.delta)
        data += confidence[p] * slope * (r - 0.5 * slope)  # c H_delta(r)
        dx, dy = differences(p, x, geometry)
        tau = smoothed_length(dx, dy, energy.eps)
        space += tau
        scale = lambda1 / tau
        to_right, to_down = scale * dx, scale * dy
        out[p] += confidence[p] * slope + from_left - to_right - to_down
        if geometry.flags[p] & HAS_DOWN:
            out[geometry.down[p]] += to_down
        from_left = to_right
    return data + lambda1 * space


@stencil
def _add_links(t, x, out, geometry, coupling, following):
    """Adds coupling B^T V e of the links t -> t + 1 to frame t, and to t + 1 if `following`; returns sum V e^2."""
    total = 0.0
    if has_links(t, geometry):
        for p in pixels_of(t, geometry):
            e = warp_residual(p, x, geometry)
            flux = coupling * geometry.link[p] * e
            total += geometry.link[p] * np.float64(e) * e
            out[p] -= flux
            if following:
                add_warp_adjoint(p, flux, out, geometry)
    return total


@kernel
def linearise(first, last, x, duals, damping, energy, matrix):
    """Fills `matrix` with the Newton system at x and the duals (Chan, Golub and Mulet 1999; the same for Huber).

    The duals are multiplied by `damping` in [0, 1]: 1 gives Newton's system, 0 that of iteratively reweighted least
    squares, which majorises F. The matrix of the spatial term is positive semidefinite while |q| <= 1, the weight of
    the data term is >= 0 while |u| <= 1. Differences are in float64, all else in the precision of the matrix.
    """
    geometry, qx, qy, u = energy.geometry, duals.qx, duals.qy, duals.u
    kind = matrix.data.dtype.type
    one, half, damping = kind(1), kind(0.5), kind(damping)
    delta, lambda1, eps2 = kind(energy.delta), kind(energy.lambda1), kind(energy.eps * energy.eps)
    for t in range(first, last):
        for p in pixels_of(t, geometry):
            r = kind(x[p] - np.float64(energy.observed[p]))
            size = abs(r)
            weight = one if size <= delta else delta * (one - damping * math.copysign(u[p], u[p] * r)) / size
            matrix.data[p] = energy.confidence[p] * weight
            right, below = differences(p, x, geometry)
            dx, dy = kind(right), kind(below)
            inverse = one / math.sqrt(dx * dx + dy * dy + eps2)
            scale, dx, dy = lambda1 * inverse, damping * dx * inverse, damping * dy * inverse
            matrix.xx[p] = scale * (one - qx[p] * dx)
            matrix.yy[p] = scale * (one - qy[p] * dy)
            matrix.xy[p] = -half * scale * (qx[p] * dy + qy[p] * dx)


@kernel
def update_duals(first, last, x, z, duals, energy):
    """Newton's step of the duals for the step z of x, projected into the unit ball; x is the value before the step."""
    geometry, qx, qy, u = energy.geometry, duals.qx, duals.qy, duals.u
    kind = z.dtype.type
    one, delta, eps2 = kind(1), kind(energy.delta), kind(energy.eps * energy.eps)
    margin = kind(BALL_MARGIN)
    for t in range(first, last):
        for p in pixels_of(t, geometry):
            r, step = kind(x[p] - np.float64(energy.observed[p])), z[p]
            sign = math.copysign(one, r)
            new_u = (r + step) / delta if abs(r) <= delta else sign + step * (one - u[p] * sign) / abs(r)
            u[p] = min(one, max(-one, new_u))
            right, below = differences(p, x, geometry)
            zx, zy = differences(p, z, geometry)
            dx, dy = kind(right), kind(below)
            inverse = one / math.sqrt(dx * dx + dy * dy + eps2)
            along = (dx * zx + dy * zy) * inverse * inverse
            new_x, new_y = (dx + zx) * inverse - qx[p] * along, (dy + zy) * inverse - qy[p] * along
            size = max(one, math.sqrt(new_x * new_x + new_y * new_y) * margin)
            shrink = one / size
            qx[p], qy[p] = new_x * shrink, new_y * shrink
