"""Kernels of the linear systems A z = -g of Newton's method: product with A, its diagonal, conjugate gradients.

As in kernels.py, a kernel processes the frames first .. last - 1, and results do not depend on the split.
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201, ANN202

from __future__ import annotations

import numpy as np

from yesnt.temporal.geometry import FIXED, HAS_DOWN, HAS_RIGHT
from yesnt.temporal.kernels import kernel
from yesnt.temporal.stencils import (
    ONE,
    add_links_into,
    add_warp_adjoint,
    differences,
    has_links,
    pixels_of,
    stencil,
    warp_residual,
)


@kernel
def apply(first, last, z, out, dots, geometry, matrix):
    """Writes out = A z [N] and, per frame in float64, z . A z; `out` is 0 at fixed pixels."""
    out[geometry.frames[first] : geometry.frames[last]] = 0
    add_links_into(first, z, out, geometry, matrix.coupling)
    for t in range(first, last):
        _apply_frame(t, z, out, geometry, matrix, t + 1 < last)
        total = 0.0
        for p in pixels_of(t, geometry):
            if geometry.flags[p] & FIXED:
                out[p] = 0
            total += np.float64(out[p]) * z[p]
        dots[t] = total


@stencil
def _apply_frame(t, z, out, geometry, matrix, following):
    """Adds A z of frame t: data, space and, if it has a next frame, links. One pass over the lists."""
    linked = has_links(t, geometry)
    from_left = np.float32(0)
    for p in pixels_of(t, geometry):
        dx, dy = differences(p, z, geometry)
        to_right, to_down = matrix.xx[p] * dx + matrix.xy[p] * dy, matrix.xy[p] * dx + matrix.yy[p] * dy
        if not geometry.flags[p] & HAS_RIGHT:
            to_right = np.float32(0)
        value = matrix.data[p] * z[p] + from_left - to_right
        from_left = to_right
        if geometry.flags[p] & HAS_DOWN:
            out[geometry.down[p]] += to_down
            value -= to_down
        if linked:
            flux = matrix.coupling * geometry.link[p] * warp_residual(p, z, geometry)
            value -= flux
            if following:
                add_warp_adjoint(p, flux, out, geometry)
        out[p] += value


@kernel
def inverse_diagonal(first, last, out, geometry, matrix):
    """Inverse of the diagonal of A [N]; 1 at fixed pixels and where the diagonal is 0 (the residual is 0 there)."""
    out[geometry.frames[first] : geometry.frames[last]] = 0
    if first > 0:
        _add_warp_diagonal(first - 1, out, geometry, matrix.coupling)
    for t in range(first, last):
        _add_frame_diagonal(t, out, geometry, matrix)
        if t + 1 < last:
            _add_warp_diagonal(t, out, geometry, matrix.coupling)
        for p in pixels_of(t, geometry):
            out[p] = np.float32(1) / out[p] if out[p] > 0 and not geometry.flags[p] & FIXED else np.float32(1)


@stencil
def _add_warp_diagonal(t, out, geometry, coupling):
    """Adds the diagonal of coupling W^T V W of the links t -> t + 1 to frame t + 1."""
    if has_links(t, geometry):
        for p in pixels_of(t, geometry):
            top, bottom, scale, w = geometry.top[p], geometry.bottom[p], coupling * geometry.link[p], geometry.weights
            out[top] += scale * w[p, 0] * w[p, 0]
            out[top + ONE] += scale * w[p, 1] * w[p, 1]
            out[bottom] += scale * w[p, 2] * w[p, 2]
            out[bottom + ONE] += scale * w[p, 3] * w[p, 3]


@stencil
def _add_frame_diagonal(t, out, geometry, matrix):
    """Adds the diagonal of frame t's data term, of its spatial term and of its own end of the links."""
    for p in pixels_of(t, geometry):
        value = matrix.data[p] + matrix.coupling * geometry.link[p]
        if geometry.flags[p] & HAS_RIGHT:
            value += matrix.xx[p]
            out[p + ONE] += matrix.xx[p]
        if geometry.flags[p] & HAS_DOWN:
            value += matrix.yy[p]
            out[geometry.down[p]] += matrix.yy[p]
            if geometry.flags[p] & HAS_RIGHT:
                value += 2 * matrix.xy[p]
        out[p] += value


@kernel
def start_cg(first, last, gradient, cg):
    """Starts at z = 0 with r = -gradient; `cg.dots` as in `advance`."""
    for t in range(first, last):
        total = 0.0
        for i in range(np.uint64(cg.frames[t]), np.uint64(cg.frames[t + 1])):
            cg.z[i] = 0
            cg.r[i] = -gradient[i]
            total += np.float64(cg.r[i]) * (cg.r[i] * cg.inverse[i])
        cg.dots[t] = total


@kernel
def advance(first, last, alpha, cg):
    """Step z += alpha p, r -= alpha A p; `cg.dots` becomes r . M^-1 r per frame."""
    for t in range(first, last):
        total = 0.0
        for i in range(np.uint64(cg.frames[t]), np.uint64(cg.frames[t + 1])):
            cg.z[i] += alpha * cg.p[i]
            cg.r[i] -= alpha * cg.ap[i]
            total += np.float64(cg.r[i]) * (cg.r[i] * cg.inverse[i])
        cg.dots[t] = total


@kernel
def turn(first, last, beta, cg):
    """New search direction p = M^-1 r + beta p."""
    for i in range(np.uint64(cg.frames[first]), np.uint64(cg.frames[last])):
        cg.p[i] = cg.r[i] * cg.inverse[i] + beta * cg.p[i]
