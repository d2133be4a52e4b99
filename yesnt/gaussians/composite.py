"""Composites the Gaussians of each tile front to back (forward pass).

The Gaussian is the outer loop and the pixels of the tile are the inner one, over one scratch array of 64 values a
channel: LLVM then evaluates several pixels at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from yesnt.gaussians.compiled import entry, kernel
from yesnt.gaussians.project import TILE, Splat
from yesnt.gaussians.reference import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

PIXELS = TILE * TILE

F = np.float32  # a Python literal would turn the arithmetic into float64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
LARGEST, LEAST, OPAQUE = F(ALPHA_MAX), F(ALPHA_MIN), F(TRANSMITTANCE_MIN)
SIXTEENTH, TAYLOR = F(-1 / 32), (F(1 / 2), F(1 / 6), F(1 / 24), F(1 / 120))
FLATTEST = F(1e-6)
"""Smallest denominator r'Gr / r_mu'Gr_mu: in float32 its rounding error is of this order."""

CHECKED = 8
"""Gaussians after which a tile looks whether all its pixels are opaque."""

COLOR, NORMAL, ALPHA, DEPTH, SQUARE, MEDIAN, PASSED, BEFORE = 0, 3, 6, 7, 8, 9, 10, 11
CHANNELS = 12
"""Accumulated images: 3 of colour, 3 of the normal, sum of weights, of weighted depth and of its square (both about the
view's reference depth), median depth, transmittance, and the transmittance in front of the Gaussian of the median."""


class Accumulated(NamedTuple):
    """What compositing writes, over whole tiles.

    Attributes:
        images: [12, rows, columns] float32.
        middle: [rows, columns] int32: which Gaussian of the tile's list holds the median; -1: none.
    """

    images: Any
    middle: Any


class Point(NamedTuple):
    """A Gaussian at a pixel: offsets from its centre, 1 / den, q, response, opacity, depth."""

    dx: Any
    dy: Any
    inverse: Any
    q: Any
    response: Any
    alpha: Any
    t: Any


@kernel
def splat_at(splats: Any, i: Any) -> Any:
    """Row i of splats as a record."""
    s = splats[i]
    return Splat(
        s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10], s[11], s[12], s[13], s[14], s[15], s[16],
        s[17],
    )  # fmt: skip


@kernel
def exp_minus_half(q: Any) -> Any:
    """exp(-q / 2) for q >= 0, relative error below 4e-5 (q < 11, all that can matter); at most exp(-8) beyond 16."""
    x = max(q * SIXTEENTH, -HALF)
    p = ONE + x * (ONE + x * (TAYLOR[0] + x * (TAYLOR[1] + x * (TAYLOR[2] + x * TAYLOR[3]))))
    p = p * p
    p = p * p
    p = p * p
    return p * p


@kernel
def evaluate(s: Any, x: Any, y: Any, passed: Any, near: Any) -> Any:
    """A splat on the ray (x, y, 1), where `passed` of the light is left."""
    dx, dy = x - s.x, y - s.y
    along = s.h1 * dx + s.h2 * dy
    inverse = ONE / max(ONE + along + along + (s.a11 * dx + s.a12 * dy) * dx + s.a22 * dy * dy, FLATTEST)
    q = max(((s.n11 * dx + s.c12 * dy) * dx + s.n22 * dy * dy) * inverse, ZERO)
    response = exp_minus_half(q)
    t = s.z * (ONE + along) * inverse
    alpha = min(s.opacity * response, LARGEST)
    alpha = alpha if alpha >= LEAST else ZERO
    alpha = alpha if passed > OPAQUE else ZERO
    alpha = alpha if t >= near else ZERO
    return Point(dx, dy, inverse, q, response, alpha, t)


@kernel
def add_splat(b: Any, first: Any, last: Any, s: Any, number: Any, pinhole: Any) -> Any:
    """Composites a splat into pixels [first, last) of a tile's scratch (rows: x, y, the images, the middle)."""
    near, origin = F(pinhole.near), F(pinhole.reference_z)
    for k in range(np.uint64(first), np.uint64(last)):
        passed = b[k + np.uint64((2 + PASSED) * PIXELS)]
        p = evaluate(s, b[k], b[k + np.uint64(PIXELS)], passed, near)
        weight, depth = p.alpha * passed, p.t - origin
        b[k + np.uint64(2 * PIXELS)] += weight * s.red
        b[k + np.uint64(3 * PIXELS)] += weight * s.green
        b[k + np.uint64(4 * PIXELS)] += weight * s.blue
        b[k + np.uint64(5 * PIXELS)] += weight * s.nx
        b[k + np.uint64(6 * PIXELS)] += weight * s.ny
        b[k + np.uint64(7 * PIXELS)] += weight * s.nz
        b[k + np.uint64(8 * PIXELS)] += weight
        b[k + np.uint64(9 * PIXELS)] += weight * depth
        b[k + np.uint64(10 * PIXELS)] += weight * depth * depth
        nearer = (passed > HALF) & (p.alpha > ZERO)
        b[k + np.uint64(11 * PIXELS)] = p.t if nearer else b[k + np.uint64(11 * PIXELS)]
        b[k + np.uint64(12 * PIXELS)] = passed - weight
        b[k + np.uint64(13 * PIXELS)] = passed if nearer else b[k + np.uint64(13 * PIXELS)]
        b[k + np.uint64(14 * PIXELS)] = number if nearer else b[k + np.uint64(14 * PIXELS)]


@kernel
def fill_rays(b: Any, row: Any, column: Any, pinhole: Any) -> Any:
    """Writes the ray (x, y, 1) of every pixel of a tile to the first two rows of its scratch."""
    for k in range(PIXELS):
        b[k] = (column * TILE + k % TILE + 0.5 - pinhole.cx) / pinhole.fx
        b[PIXELS + k] = (row * TILE + k // TILE + 0.5 - pinhole.cy) / pinhole.fy


@kernel
def rows_of(box: Any, row: Any) -> Any:
    """Pixels [first, last) of a tile that a Gaussian reaches, in whole groups of four rows.

    Loops of a multiple of 32 pixels stay vectorised to their end.
    """
    first, last = max(box[4] - row * TILE, 0), min(box[5] - row * TILE, TILE)
    return first // 4 * 4 * TILE, (last + 3) // 4 * 4 * TILE


@kernel
def all_opaque(passed: Any) -> Any:
    """Whether no pixel of a tile takes a further Gaussian; passed [64]."""
    most = ZERO
    for k in range(PIXELS):
        most = max(most, passed[k])
    return most <= OPAQUE


@kernel
def store(b: Any, row: Any, column: Any, out: Any) -> Any:
    """Copies a tile's scratch to the images; the median holds only where the transmittance has crossed 0.5."""
    for k in range(PIXELS):
        y, x = row * TILE + k // TILE, column * TILE + k % TILE
        crossed = b[(2 + PASSED) * PIXELS + k] <= HALF
        for channel in range(CHANNELS):
            out.images[channel, y, x] = b[(2 + channel) * PIXELS + k]
        out.images[MEDIAN, y, x] = b[(2 + MEDIAN) * PIXELS + k] if crossed else ZERO
        out.middle[y, x] = int(b[(2 + CHANNELS) * PIXELS + k]) if crossed else -1


@entry
def composite_tiles(first: Any, last: Any, projected: Any, lists: Any, pinhole: Any, out: Any) -> Any:
    """Composites tiles [first, last) into `Accumulated`, whose sides are whole tiles."""
    columns = out.middle.shape[1] // TILE
    b = np.empty((3 + CHANNELS) * PIXELS, np.float32)
    for tile in range(first, last):
        row, column = tile // columns, tile % columns
        b[:] = ZERO
        fill_rays(b, row, column, pinhole)
        for k in range(PIXELS):
            b[(2 + PASSED) * PIXELS + k], b[(2 + CHANNELS) * PIXELS + k] = ONE, -ONE
        start = lists.starts[tile]
        for j in range(start, lists.starts[tile + 1]):
            i = lists.members[j]
            a, z = rows_of(projected.boxes[i], row)
            add_splat(b, a, z, splat_at(projected.splats, i), F(j - start), pinhole)
            if (j - start) % CHECKED == CHECKED - 1 and all_opaque(b[(2 + PASSED) * PIXELS : (3 + PASSED) * PIXELS]):
                break
        store(b, row, column, out)
