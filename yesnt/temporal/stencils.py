"""Differences in space and along the flow on compact pixel lists, and their adjoints: the operators D and W.

These functions are compiled into the kernels that call them. Indices are unsigned: for signed ones Numba tests whether
they count from the end, which makes the kernels three times slower.
"""
# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: ANN001, ANN201

from __future__ import annotations

import numpy as np

from yesnt.core.compiled import compiled
from yesnt.temporal.geometry import HAS_DOWN, HAS_RIGHT

ONE = np.uint64(1)

stencil = compiled(_nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorator of functions that only kernels call. They create no arrays, so no references are counted (`_nrt`), and have
no entry points for Python and C, which halves the time to compile them."""


@stencil
def pixels_of(t, geometry):
    """Range of the indices of frame t's pixels, unsigned."""
    return range(np.uint64(geometry.frames[t]), np.uint64(geometry.frames[t + 1]))


@stencil
def has_links(t, geometry):
    """Whether frame t has a next frame with pixels."""
    return t + 2 < len(geometry.frames) and geometry.frames[t + 2] > geometry.frames[t + 1]


@stencil
def differences(p, x, geometry):
    """Forward differences (Dx x, Dy x) at pixel p; 0 where there is no neighbour."""
    flags = geometry.flags[p]
    zero = x[p] * 0
    dx = x[p + ONE] - x[p] if flags & HAS_RIGHT else zero
    dy = x[geometry.down[p]] - x[p] if flags & HAS_DOWN else zero
    return dx, dy


@stencil
def warp_residual(p, x, geometry):
    """E = (W x_{t+1})(p) - x_t(p). The differences are weighted, not the values: a constant gives exactly 0."""
    x_p, top, bottom, w = x[p], geometry.top[p], geometry.bottom[p], geometry.weights
    upper = w[p, 0] * (x[top] - x_p) + w[p, 1] * (x[top + ONE] - x_p)
    return upper + (w[p, 2] * (x[bottom] - x_p) + w[p, 3] * (x[bottom + ONE] - x_p))


@stencil
def add_warp_adjoint(p, flux, out, geometry):
    """Adds W^T flux to frame t + 1. All four samples lie in that frame; absent ones have weight 0."""
    top, bottom, w = geometry.top[p], geometry.bottom[p], geometry.weights
    out[top] += w[p, 0] * flux
    out[top + ONE] += w[p, 1] * flux
    out[bottom] += w[p, 2] * flux
    out[bottom + ONE] += w[p, 3] * flux


@stencil
def add_links_into(t, x, out, geometry, coupling):
    """Adds coupling W^T V e of the links t - 1 -> t to frame t: for a group of frames that starts at t."""
    if t > 0 and has_links(t - 1, geometry):
        for p in pixels_of(t - 1, geometry):
            add_warp_adjoint(p, coupling * geometry.link[p] * warp_residual(p, x, geometry), out, geometry)
