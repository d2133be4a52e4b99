"""Gradients of the composited images by the splats of each tile (backward pass), hand-written.

Front to back again: what lies behind a Gaussian is the pixel's total less what was composited so far. Each pair of
Gaussian and tile has one slot of `SUMS` numbers, so that no two threads add to one place and every sum has one order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from yesnt.gaussians.compiled import entry, kernel
from yesnt.gaussians.composite import (
    CHECKED,
    HALF,
    LARGEST,
    MEDIAN,
    ONE,
    PIXELS,
    TWO,
    ZERO,
    F,
    all_opaque,
    evaluate,
    fill_rays,
    rows_of,
    splat_at,
)  # fmt: skip
from yesnt.gaussians.project import TILE

GRADIENTS = 10
"""Images that have a gradient: the first ten of composite.py."""

SUMS = 21
"""Numbers of a slot. With e, f, k the gradients by the numerator of q, by den and by half of (1 + h.d)'s factor:
sums of e dx, e dy, e dx^2, e dx dy, e dy^2, k, k dx, k dy, f dx, f dy, f dx^2, f dx dy, f dy^2, of the depth's gradient
times the depth, of the gradients by opacity, colour (3) and normal (3).
"""

_REST, _GRADIENT, _MIDDLE = 3, 4, 14  # rows of the scratch: what lies behind, gradients, number of the median
_ROWS = 15


class PixelGradient(NamedTuple):
    """Gradient of the loss by the images of a pixel."""

    red: Any
    green: Any
    blue: Any
    nx: Any
    ny: Any
    nz: Any
    alpha: Any
    depth: Any
    square: Any
    median: Any


@kernel
def gradient_at(b: Any, k: Any) -> Any:
    """The gradients of pixel k of a tile's scratch."""
    return PixelGradient(
        b[k + np.uint64(4 * PIXELS)], b[k + np.uint64(5 * PIXELS)], b[k + np.uint64(6 * PIXELS)],
        b[k + np.uint64(7 * PIXELS)], b[k + np.uint64(8 * PIXELS)], b[k + np.uint64(9 * PIXELS)],
        b[k + np.uint64(10 * PIXELS)], b[k + np.uint64(11 * PIXELS)], b[k + np.uint64(12 * PIXELS)],
        b[k + np.uint64(13 * PIXELS)],
    )  # fmt: skip


@kernel
def sum_gradients(b: Any, first: Any, last: Any, s: Any, number: Any, pinhole: Any, out: Any) -> Any:
    """Writes the sums of a splat over pixels [first, last) of a tile to its slot."""
    near, origin = F(pinhole.near), F(pinhole.reference_z)
    ex, ey, exx, exy, eyy = ZERO, ZERO, ZERO, ZERO, ZERO
    fx, fy, fxx, fxy, fyy = ZERO, ZERO, ZERO, ZERO, ZERO
    ks, kx, ky, ts, os = ZERO, ZERO, ZERO, ZERO, ZERO
    red, green, blue, nx, ny, nz = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for k in range(np.uint64(first), np.uint64(last)):
        passed = b[k + np.uint64(2 * PIXELS)]
        p, g = evaluate(s, b[k], b[k + np.uint64(PIXELS)], passed, near), gradient_at(b, k)
        weight, depth = p.alpha * passed, p.t - origin
        b[k + np.uint64(2 * PIXELS)] = passed - weight
        value = g.red * s.red + g.green * s.green + g.blue * s.blue + g.nx * s.nx + g.ny * s.ny + g.nz * s.nz
        value += g.alpha + depth * (g.depth + depth * g.square)  # what a unit of weight is worth
        behind = b[k + np.uint64(_REST * PIXELS)] - weight * value
        b[k + np.uint64(_REST * PIXELS)] = behind
        by_alpha = passed * value - behind / (ONE - p.alpha)
        by_alpha = by_alpha if p.alpha > ZERO else ZERO
        by_alpha = by_alpha if s.opacity * p.response < LARGEST else ZERO
        by_q = -HALF * by_alpha * p.alpha
        by_t = weight * (g.depth + TWO * depth * g.square)
        by_t += g.median if b[k + np.uint64(_MIDDLE * PIXELS)] == number else ZERO
        e, f = by_q * p.inverse, -(by_q * p.q + by_t * p.t) * p.inverse
        half_along = f + HALF * by_t * s.z * p.inverse
        ex += e * p.dx
        ey += e * p.dy
        exx += e * p.dx * p.dx
        exy += e * p.dx * p.dy
        eyy += e * p.dy * p.dy
        fx += f * p.dx
        fy += f * p.dy
        fxx += f * p.dx * p.dx
        fxy += f * p.dx * p.dy
        fyy += f * p.dy * p.dy
        ks += half_along
        kx += half_along * p.dx
        ky += half_along * p.dy
        ts += by_t * p.t
        os += by_alpha * p.response
        red += weight * g.red
        green += weight * g.green
        blue += weight * g.blue
        nx += weight * g.nx
        ny += weight * g.ny
        nz += weight * g.nz
    out[0], out[1], out[2], out[3], out[4] = ex, ey, exx, exy, eyy
    out[5], out[6], out[7] = ks, kx, ky
    out[8], out[9], out[10], out[11], out[12] = fx, fy, fxx, fxy, fyy
    out[13], out[14], out[15], out[16], out[17], out[18], out[19], out[20] = ts, os, red, green, blue, nx, ny, nz


@kernel
def load(b: Any, row: Any, column: Any, forward: Any, gradient: Any) -> Any:
    """Fills a tile's scratch from the forward pass and the images' gradient; returns whether any gradient is not 0."""
    height, width = gradient.shape[1], gradient.shape[2]
    some = False
    for k in range(PIXELS):
        y, x = row * TILE + k // TILE, column * TILE + k % TILE
        b[2 * PIXELS + k], b[_MIDDLE * PIXELS + k] = ONE, F(forward.middle[y, x])
        total = ZERO
        for channel in range(GRADIENTS):
            g = gradient[channel, y, x] if y < height and x < width else ZERO
            b[(_GRADIENT + channel) * PIXELS + k] = g
            some |= g != ZERO
            if channel != MEDIAN:
                total += g * forward.images[channel, y, x]
        b[_REST * PIXELS + k] = total
    return some


@entry
def tile_gradients(
    first: Any, last: Any, projected: Any, lists: Any, pinhole: Any, forward: Any, gradient: Any, sums: Any
) -> Any:
    """Writes the slots of tiles [first, last): sums [P, 21] from the gradient [10, H, W] of the images."""
    columns = forward.middle.shape[1] // TILE
    b = np.zeros(_ROWS * PIXELS, np.float32)
    for tile in range(first, last):
        row, column = tile // columns, tile % columns
        start, stop = lists.starts[tile], lists.starts[tile + 1]
        done = start
        if start < stop and load(b, row, column, forward, gradient):
            fill_rays(b, row, column, pinhole)
            for j in range(start, stop):
                i = lists.members[j]
                a, z = rows_of(projected.boxes[i], row)
                sum_gradients(b, a, z, splat_at(projected.splats, i), F(j - start), pinhole, sums[lists.slots[j]])
                done = j + 1
                if (j - start) % CHECKED == CHECKED - 1 and all_opaque(b[2 * PIXELS : 3 * PIXELS]):
                    break
        for j in range(done, stop):
            sums[lists.slots[j]] = ZERO
