"""Fused kernels of the temporal energy on compact pixel lists: gradient, linear operator, conjugate gradients.

A public kernel does the frames first .. last - 1 and releases the interpreter; threads.py runs several at once. A
frame's sums are always added in the same order, and reductions are per frame and float64, so the bits do not depend on
the split. No `fastmath`, for the same reason: the compiler may not reassociate. Indices are unsigned, because numba
tests signed ones for Python's counting from the end, which costs a factor of three here.

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
from numba import njit

from yesnt.temporal.geometry import FIXED, HAS_DOWN, HAS_RIGHT

ONE = np.uint64(1)


@njit(cache=True)
def pixels_of(t, geo):
    """Unsigned range of frame t's pixels."""
    return range(np.uint64(geo.frames[t]), np.uint64(geo.frames[t + 1]))


@njit(cache=True)
def differences(p, x, geo):
    """Forward differences (right, down) at pixel p; 0 where there is no neighbour."""
    flags = geo.flags[p]
    zero = x[p] * 0
    dx = x[p + ONE] - x[p] if flags & HAS_RIGHT else zero
    dy = x[geo.down[p]] - x[p] if flags & HAS_DOWN else zero
    return dx, dy


@njit(cache=True)
def link_residual(p, x, geo):
    """Residual e = W x_{t+1} - x_t; differences first, so that rounding of the weights costs nothing on constants."""
    here, top, bottom, w = x[p], geo.top[p], geo.bottom[p], geo.weights
    upper = w[p, 0] * (x[top] - here) + w[p, 1] * (x[top + ONE] - here)
    return upper + (w[p, 2] * (x[bottom] - here) + w[p, 3] * (x[bottom + ONE] - here))


@njit(cache=True)
def scatter_next(p, flux, out, geo):
    """Adds W^T flux to frame t + 1; stencils stay inside that frame, so no branch is needed."""
    top, bottom, w = geo.top[p], geo.bottom[p], geo.weights
    out[top] += w[p, 0] * flux
    out[top + ONE] += w[p, 1] * flux
    out[bottom] += w[p, 2] * flux
    out[bottom + ONE] += w[p, 3] * flux


@njit(cache=True)
def has_links(t, geo):
    """Whether frame t has a next frame with pixels."""
    return t + 2 < len(geo.frames) and geo.frames[t + 2] > geo.frames[t + 1]


@njit(cache=True)
def links_into(t, x, out, geo, scale):
    """Adds scale W^T V e of the links t - 1 -> t to frame t, for a group that starts at frame t."""
    if t > 0 and has_links(t - 1, geo):
        for p in pixels_of(t - 1, geo):
            scatter_next(p, scale * geo.link[p] * link_residual(p, x, geo), out, geo)


@njit(cache=True)
def links_from(t, x, out, geo, scale, following):
    """Adds scale B^T V B x of the links t -> t + 1 to frame t, and to t + 1 if `following`; returns sum V e^2."""
    total = 0.0
    if has_links(t, geo):
        for p in pixels_of(t, geo):
            e = link_residual(p, x, geo)
            flux = scale * geo.link[p] * e
            total += geo.link[p] * np.float64(e) * e
            out[p] -= flux
            if following:
                scatter_next(p, flux, out, geo)
    return total


@njit(cache=True)
def _gradient_space(t, x, out, geo, observed, confidence, params):
    """Adds the gradient of the data and the spatial term of frame t; returns their energy."""
    delta, lambda1, _, eps = params
    data, space, from_left = 0.0, 0.0, 0.0
    for p in pixels_of(t, geo):
        r = x[p] - np.float64(observed[p])
        slope = min(delta, max(-delta, r))
        data += confidence[p] * slope * (r - 0.5 * slope)
        dx, dy = differences(p, x, geo)
        tau = math.sqrt(dx * dx + dy * dy + eps * eps)
        space += tau
        scale = lambda1 / tau
        to_right, to_down = scale * dx, scale * dy
        out[p] += confidence[p] * slope + from_left - to_right - to_down
        if geo.flags[p] & HAS_DOWN:
            out[geo.down[p]] += to_down
        from_left = to_right
    return data + lambda1 * space


@njit(cache=True, nogil=True)
def gradient(first, last, x, out, energies, geo, observed, confidence, params):
    """Gradient [N] and energy per frame [T] of F at x [N], float64; 0 gradient at fixed pixels.

    `params` is (delta, lambda1, lambda2, eps).
    """
    out[geo.frames[first] : geo.frames[last]] = 0.0
    coupling = 2.0 * params[2]
    links_into(first, x, out, geo, coupling)
    for t in range(first, last):
        energy = _gradient_space(t, x, out, geo, observed, confidence, params)
        energies[t] = energy + params[2] * links_from(t, x, out, geo, coupling, t + 1 < last)
        for p in pixels_of(t, geo):
            if geo.flags[p] & FIXED:
                out[p] = 0.0


@njit(cache=True, nogil=True)
def linearise(first, last, x, duals, damping, geo, observed, confidence, params, operator):
    """Weights of the Newton system at x with duals (qx, qy, u) (Chan, Golub, Mulet 1999, and the same for Huber).

    The duals are scaled by `damping` in [0, 1]; with 0 the weights are those of iteratively reweighted least squares,
    which majorise F. Fills `operator` = (data, a, b, d), [N] each: the spatial term's matrix at a pixel is
    ((a, b), (b, d)). It is positive semidefinite while |q| <= 1, and the data weight is not negative while |u| <= 1.
    Differences are taken in float64, what follows in the operator's precision.
    """
    qx, qy, u = duals
    data, a, b, d = operator
    kind = data.dtype.type
    one, half, damping = kind(1), kind(0.5), kind(damping)
    delta, lambda1, eps2 = kind(params[0]), kind(params[1]), kind(params[3] * params[3])
    for t in range(first, last):
        for p in pixels_of(t, geo):
            r = kind(x[p] - np.float64(observed[p]))
            size = abs(r)
            weight = one if size <= delta else delta * (one - damping * math.copysign(u[p], u[p] * r)) / size
            data[p] = confidence[p] * weight
            right, below = differences(p, x, geo)
            dx, dy = kind(right), kind(below)
            inverse = one / math.sqrt(dx * dx + dy * dy + eps2)
            scale, dx, dy = lambda1 * inverse, damping * dx * inverse, damping * dy * inverse
            a[p] = scale * (one - qx[p] * dx)
            d[p] = scale * (one - qy[p] * dy)
            b[p] = -half * scale * (qx[p] * dy + qy[p] * dx)


@njit(cache=True, nogil=True)
def update_duals(first, last, x, z, qx, qy, u, geo, observed, params):
    """Newton's step of the duals for the step z of x, put back into the unit ball; x is the value before the step."""
    kind = z.dtype.type
    one, delta, eps2 = kind(1), kind(params[0]), kind(params[3] * params[3])
    # The margin keeps |q| <= 1 after rounding to float32, as the certificate needs.
    margin = kind(1.0 + 5e-7)
    for t in range(first, last):
        for p in pixels_of(t, geo):
            r, step = kind(x[p] - np.float64(observed[p])), z[p]
            sign = math.copysign(one, r)
            new_u = (r + step) / delta if abs(r) <= delta else sign + step * (one - u[p] * sign) / abs(r)
            u[p] = min(one, max(-one, new_u))
            right, below = differences(p, x, geo)
            zx, zy = differences(p, z, geo)
            dx, dy = kind(right), kind(below)
            inverse = one / math.sqrt(dx * dx + dy * dy + eps2)
            along = (dx * zx + dy * zy) * inverse * inverse
            new_x, new_y = (dx + zx) * inverse - qx[p] * along, (dy + zy) * inverse - qy[p] * along
            size = max(one, math.sqrt(new_x * new_x + new_y * new_y) * margin)
            shrink = one / size
            qx[p], qy[p] = new_x * shrink, new_y * shrink


@njit(cache=True)
def _apply_frame(t, z, out, geo, operator, coupling, following):
    """Adds A z of frame t: data, space and, where there is a next frame, links. One pass over the lists."""
    data, a, b, d = operator
    linked = has_links(t, geo)
    from_left = np.float32(0)
    for p in pixels_of(t, geo):
        dx, dy = differences(p, z, geo)
        to_right, to_down = a[p] * dx + b[p] * dy, b[p] * dx + d[p] * dy
        if not geo.flags[p] & HAS_RIGHT:
            to_right = np.float32(0)
        value = data[p] * z[p] + from_left - to_right
        from_left = to_right
        if geo.flags[p] & HAS_DOWN:
            out[geo.down[p]] += to_down
            value -= to_down
        if linked:
            flux = coupling * geo.link[p] * link_residual(p, z, geo)
            value -= flux
            if following:
                scatter_next(p, flux, out, geo)
        out[p] += value


@njit(cache=True, nogil=True)
def apply(first, last, z, out, dots, geo, operator, coupling):
    """Writes out = A z [N], float32, and z . A z per frame in float64; `coupling` is 2 lambda2."""
    out[geo.frames[first] : geo.frames[last]] = 0
    links_into(first, z, out, geo, coupling)
    for t in range(first, last):
        _apply_frame(t, z, out, geo, operator, coupling, t + 1 < last)
        total = 0.0
        for p in pixels_of(t, geo):
            if geo.flags[p] & FIXED:
                out[p] = 0
            total += np.float64(out[p]) * z[p]
        dots[t] = total


@njit(cache=True)
def _diagonal_links(t, out, geo, coupling):
    """Adds the diagonal of the links t -> t + 1 at their sampled end."""
    if has_links(t, geo):
        for p in pixels_of(t, geo):
            top, bottom, scale, w = geo.top[p], geo.bottom[p], coupling * geo.link[p], geo.weights
            out[top] += scale * w[p, 0] * w[p, 0]
            out[top + ONE] += scale * w[p, 1] * w[p, 1]
            out[bottom] += scale * w[p, 2] * w[p, 2]
            out[bottom + ONE] += scale * w[p, 3] * w[p, 3]


@njit(cache=True)
def _diagonal_space(t, out, geo, operator, coupling):
    """Adds the diagonal of frame t's data and spatial terms and of its own end of the links."""
    data, a, b, d = operator
    for p in pixels_of(t, geo):
        value = data[p] + coupling * geo.link[p]
        if geo.flags[p] & HAS_RIGHT:
            value += a[p]
            out[p + ONE] += a[p]
        if geo.flags[p] & HAS_DOWN:
            value += d[p]
            out[geo.down[p]] += d[p]
            if geo.flags[p] & HAS_RIGHT:
                value += 2 * b[p]
        out[p] += value


@njit(cache=True, nogil=True)
def inverse_diagonal(first, last, out, geo, operator, coupling):
    """One over the diagonal of A [N]; 1 at fixed pixels and where A has no entry (their residual is 0)."""
    out[geo.frames[first] : geo.frames[last]] = 0
    if first > 0:
        _diagonal_links(first - 1, out, geo, coupling)
    for t in range(first, last):
        _diagonal_space(t, out, geo, operator, coupling)
        if t + 1 < last:
            _diagonal_links(t, out, geo, coupling)
        for p in pixels_of(t, geo):
            out[p] = np.float32(1) / out[p] if out[p] > 0 and not geo.flags[p] & FIXED else np.float32(1)


@njit(cache=True, nogil=True)
def start_cg(first, last, gradient, inverse, z, r, frames, dots):
    """Starts conjugate gradients at z = 0 for the right-hand side - gradient; `dots` as in `advance`."""
    for t in range(first, last):
        total = 0.0
        for i in range(np.uint64(frames[t]), np.uint64(frames[t + 1])):
            z[i] = 0
            r[i] = -gradient[i]
            total += np.float64(r[i]) * (r[i] * inverse[i])
        dots[t] = total


@njit(cache=True, nogil=True)
def advance(first, last, alpha, z, r, p, ap, inverse, frames, dots):
    """Step: z += alpha p, r -= alpha A p, and r . M^-1 r per frame."""
    for t in range(first, last):
        total = 0.0
        for i in range(np.uint64(frames[t]), np.uint64(frames[t + 1])):
            z[i] += alpha * p[i]
            r[i] -= alpha * ap[i]
            total += np.float64(r[i]) * (r[i] * inverse[i])
        dots[t] = total


@njit(cache=True, nogil=True)
def turn(first, last, beta, p, r, inverse, frames):
    """Turn: p = M^-1 r + beta p."""
    for i in range(np.uint64(frames[first]), np.uint64(frames[last])):
        p[i] = r[i] * inverse[i] + beta * p[i]
