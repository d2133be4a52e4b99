"""Fused kernels of the temporal energy on compact pixel lists: gradient, linear operator, diagonal, dual value.

Every kernel runs over groups of frames in parallel. A frame's sums are always added in the same order, whatever the
groups, and reductions are per frame and float64, so the bits do not depend on the number of threads. Without `fastmath`
for the same reason: the compiler may not reassociate.

The energy's three terms and their duals:
    data   c H(x - o)              derivative c delta u,    |u| <= 1
    space  lambda1 |(d, eps)|      derivative lambda1 q,    |q| <= 1,  d = (Dx x, Dy x), tau = sqrt(|d|^2 + eps^2)
    time   lambda2 V e^2           derivative 2 lambda2 V e,           e = W x_{t+1} - x_t
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201, ANN202

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from yesnt.temporal.geometry import FIXED, HAS_RIGHT


@njit(cache=True)
def _differences(p, x, geo):
    """Forward differences (right, down) at pixel p; 0 where there is no neighbour."""
    dx = x[p + 1] - x[p] if geo.flags[p] & HAS_RIGHT else x[p] * 0
    down = geo.down[p]
    dy = x[down] - x[p] if down >= 0 else x[p] * 0
    return dx, dy


@njit(cache=True)
def _link_residual(p, x, geo):
    """Residual e = W x_{t+1} - x_t; differences first, so that rounding of the weights costs nothing on constants."""
    here, top, bottom = x[p], geo.top[p], geo.bottom[p]
    w = geo.weights
    return (
        w[p, 0] * (x[top] - here)
        + w[p, 1] * (x[top + 1] - here)
        + w[p, 2] * (x[bottom] - here)
        + w[p, 3] * (x[bottom + 1] - here)
    )


@njit(cache=True)
def _scatter_next(p, value, out, geo):
    """Adds W^T value to frame t + 1. A weight of 0 may point into another thread's frame: it must not be written."""
    w, top, bottom = geo.weights, geo.top[p], geo.bottom[p]
    if w[p, 0] != 0:
        out[top] += w[p, 0] * value
    if w[p, 1] != 0:
        out[top + 1] += w[p, 1] * value
    if w[p, 2] != 0:
        out[bottom] += w[p, 2] * value
    if w[p, 3] != 0:
        out[bottom + 1] += w[p, 3] * value


@njit(cache=True)
def _links(t, x, out, geo, scale, own, following):
    """Adds scale V B^T B x of the links t -> t + 1 to frame t (if `own`) and to frame t + 1 (if `following`)."""
    energy = 0.0
    for p in range(geo.frames[t], geo.frames[t + 1]):
        if geo.link[p] > 0:
            e = _link_residual(p, x, geo)
            flux = scale * geo.link[p] * e
            energy += np.float64(flux) * e
            if own:
                out[p] -= flux
            if following:
                _scatter_next(p, flux, out, geo)
    return energy


@njit(cache=True)
def _tv_gradient(t, x, out, geo, lambda1, eps):
    """Adds D^T (lambda1 d / tau) of frame t; returns the term's energy."""
    energy = 0.0
    for p in range(geo.frames[t], geo.frames[t + 1]):
        dx, dy = _differences(p, x, geo)
        tau = math.sqrt(dx * dx + dy * dy + eps * eps)
        energy += tau
        scale = lambda1 / tau
        out[p] -= scale * (dx + dy)
        if dx != 0:
            out[p + 1] += scale * dx
        if dy != 0:
            out[geo.down[p]] += scale * dy
    return lambda1 * energy


@njit(cache=True)
def _data_gradient(t, x, out, geo, observed, confidence, delta):
    """Writes c H'(x - o) of frame t; returns the term's energy."""
    energy = 0.0
    for p in range(geo.frames[t], geo.frames[t + 1]):
        r = x[p] - np.float64(observed[p])
        c = np.float64(confidence[p])
        size = abs(r)
        if size <= delta:
            energy += c * 0.5 * r * r
            out[p] = c * r
        else:
            energy += c * delta * (size - 0.5 * delta)
            out[p] = c * math.copysign(delta, r)
    return energy


@njit(cache=True, parallel=True)
def gradient(x, out, energies, geo, observed, confidence, params, groups):
    """Gradient [N] and energy per frame [T] of F at x [N], float64; 0 gradient at fixed pixels.

    `params` is (delta, lambda1, lambda2, eps); `groups` [G + 1] splits the frames over threads.
    """
    delta, lambda1, lambda2, eps = params
    for group in prange(len(groups) - 1):
        first, last = groups[group], groups[group + 1]
        energies[first] = _data_gradient(first, x, out, geo, observed, confidence, delta)
        if first > 0:
            _links(first - 1, x, out, geo, 2.0 * lambda2, False, True)
        for t in range(first, last):
            if t + 1 < last:
                energies[t + 1] = _data_gradient(t + 1, x, out, geo, observed, confidence, delta)
            energies[t] += _tv_gradient(t, x, out, geo, lambda1, eps)
            energies[t] += 0.5 * _links(t, x, out, geo, 2.0 * lambda2, True, t + 1 < last)
            for p in range(geo.frames[t], geo.frames[t + 1]):
                if geo.flags[p] & FIXED:
                    out[p] = 0.0


@njit(cache=True, parallel=True)
def linearise(x, qx, qy, u, geo, observed, confidence, params, data, a, b, d):
    """Weights of the Newton system at x with duals q, u (Chan, Golub, Mulet 1999, and the same for Huber's function).

    With q = 0, u = 0 they are the weights of iteratively reweighted least squares, which majorise F. Fills data,
    a, b, d [N]: the spatial term's matrix at a pixel is ((a, b), (b, d)). It is positive semidefinite while |q| <= 1,
    and the data weight is not negative while |u| <= 1. (Four arguments and not a tuple: numba drops writes to arrays
    that a parallel function unpacks from a tuple.)
    """
    delta, lambda1, _, eps = params
    for p in prange(len(x)):
        r = x[p] - np.float64(observed[p])
        c = np.float64(confidence[p])
        if abs(r) <= delta:
            data[p] = c
        else:
            data[p] = c * delta * (1.0 - u[p] * math.copysign(1.0, r)) / abs(r)
        dx, dy = _differences(p, x, geo)
        tau = math.sqrt(dx * dx + dy * dy + eps * eps)
        scale = lambda1 / tau
        dx, dy = dx / tau, dy / tau
        a[p] = scale * (1.0 - qx[p] * dx)
        d[p] = scale * (1.0 - qy[p] * dy)
        b[p] = -0.5 * scale * (qx[p] * dy + qy[p] * dx)


@njit(cache=True, parallel=True)
def update_duals(x, z, qx, qy, u, geo, observed, params):
    """Newton's step of the duals for the step z of x, clipped to the unit ball; x is the value before the step."""
    delta, _, _, eps = params
    for p in prange(len(x)):
        r = x[p] - np.float64(observed[p])
        if abs(r) <= delta:
            new_u = (r + z[p]) / delta
        else:
            sign = math.copysign(1.0, r)
            new_u = sign + z[p] * (1.0 - u[p] * sign) / abs(r)
        u[p] = min(1.0, max(-1.0, new_u))
        dx, dy = _differences(p, x, geo)
        zx, zy = _differences(p, z, geo)
        tau = math.sqrt(dx * dx + dy * dy + eps * eps)
        along = (dx * zx + dy * zy) / (tau * tau)
        new_x, new_y = (dx + zx) / tau - qx[p] * along, (dy + zy) / tau - qy[p] * along
        size = max(1.0, math.sqrt(new_x * new_x + new_y * new_y) * (1.0 + 1e-7))  # |q| <= 1 after rounding, too
        qx[p], qy[p] = new_x / size, new_y / size


@njit(cache=True)
def _apply_space(t, z, out, geo, a, b, d):
    """Adds D^T ((a, b), (b, d)) D z of frame t."""
    for p in range(geo.frames[t], geo.frames[t + 1]):
        dx, dy = _differences(p, z, geo)
        fx, fy = a[p] * dx + b[p] * dy, b[p] * dx + d[p] * dy
        if geo.flags[p] & HAS_RIGHT:
            out[p] -= fx
            out[p + 1] += fx
        down = geo.down[p]
        if down >= 0:
            out[p] -= fy
            out[down] += fy


@njit(cache=True)
def _start_frame(t, z, out, geo, data):
    """Writes out = data * z on frame t."""
    for p in range(geo.frames[t], geo.frames[t + 1]):
        out[p] = data[p] * z[p]


@njit(cache=True, parallel=True)
def apply(z, out, dots, geo, operator, coupling, groups):
    """Writes out = A z of the linearised energy, float32 [N], and z . A z per frame in float64; `coupling` is 2 lambda2."""
    data, a, b, d = operator
    for group in prange(len(groups) - 1):
        first, last = groups[group], groups[group + 1]
        _start_frame(first, z, out, geo, data)
        if first > 0:
            _links(first - 1, z, out, geo, coupling, False, True)
        for t in range(first, last):
            if t + 1 < last:
                _start_frame(t + 1, z, out, geo, data)
            _apply_space(t, z, out, geo, a, b, d)
            _links(t, z, out, geo, coupling, True, t + 1 < last)
            total = 0.0
            for p in range(geo.frames[t], geo.frames[t + 1]):
                if geo.flags[p] & FIXED:
                    out[p] = 0
                total += np.float64(out[p]) * z[p]
            dots[t] = total


@njit(cache=True)
def _diagonal_space(t, out, geo, a, b, d, coupling):
    """Adds the diagonal of frame t's spatial term and of its own end of the links."""
    for p in range(geo.frames[t], geo.frames[t + 1]):
        right, down = geo.flags[p] & HAS_RIGHT, geo.down[p]
        if right:
            out[p] += a[p]
            out[p + 1] += a[p]
        if down >= 0:
            out[p] += d[p]
            out[down] += d[p]
            if right:
                out[p] += 2 * b[p]
        out[p] += coupling * geo.link[p]


@njit(cache=True)
def _diagonal_links(t, out, geo, coupling):
    """Adds the diagonal of the links t -> t + 1 at their sampled end."""
    for p in range(geo.frames[t], geo.frames[t + 1]):
        for k in range(4):
            w = geo.weights[p, k]
            if w != 0:
                out[(geo.top[p] if k < 2 else geo.bottom[p]) + (k & 1)] += coupling * geo.link[p] * w * w


@njit(cache=True, parallel=True)
def diagonal(out, geo, operator, coupling, groups):
    """Diagonal of A [N]; 1 at fixed pixels and where A has no entry (their residual is 0)."""
    data, a, b, d = operator
    for group in prange(len(groups) - 1):
        first, last = groups[group], groups[group + 1]
        for p in range(geo.frames[first], geo.frames[last]):
            out[p] = data[p]
        if first > 0:
            _diagonal_links(first - 1, out, geo, coupling)
        for t in range(first, last):
            _diagonal_space(t, out, geo, a, b, d, coupling)
            if t + 1 < last:
                _diagonal_links(t, out, geo, coupling)
        for p in range(geo.frames[first], geo.frames[last]):
            if geo.flags[p] & FIXED or not out[p] > 0:
                out[p] = 1


@njit(cache=True, parallel=True)
def start_cg(gradient, diagonal, z, r, p, frames, dots):
    """Starts conjugate gradients at z = 0 for the right-hand side - gradient; `dots` as in `advance`."""
    for t in prange(len(frames) - 1):
        total = 0.0
        for i in range(frames[t], frames[t + 1]):
            z[i] = 0
            r[i] = -gradient[i]
            p[i] = r[i] / diagonal[i]
            total += np.float64(r[i]) * p[i]
        dots[t] = total


@njit(cache=True, parallel=True)
def advance(alpha, z, r, p, ap, diagonal, frames, dots):
    """Step: z += alpha p, r -= alpha A p, and r . M^-1 r per frame."""
    for t in prange(len(frames) - 1):
        total = 0.0
        for i in range(frames[t], frames[t + 1]):
            z[i] += alpha * p[i]
            r[i] -= alpha * ap[i]
            total += np.float64(r[i]) * (r[i] / diagonal[i])
        dots[t] = total


@njit(cache=True, parallel=True)
def turn(beta, p, r, diagonal):
    """Turn: p = M^-1 r + beta p."""
    for i in prange(len(p)):
        p[i] = r[i] / diagonal[i] + beta * p[i]
