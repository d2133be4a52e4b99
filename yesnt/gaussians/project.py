"""Screen-space parameters of every Gaussian for a view, and the pixels that it can reach.

With the centre mu in camera axes, r_mu = mu / mu_z, the covariance S and its adjugate G = det(S) S^-1, the response
along the ray r = r_mu + (dx, dy, 0) is exp(-q / 2) with q = (mu x r)' S (mu x r) / (r' G r), and its maximum lies at
t* = mu_z (r' G r_mu) / (r' G r). No inverse is taken: the textbook form C - B^2 / (4A) subtracts large numbers and
loses thin Gaussians in float32. Written out in dx and dy, numerator and denominator are two polynomials of degree 2.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from yesnt.gaussians.algebra import (
    dot,
    from_axes,
    into_camera,
    normalised_quaternion,
    quaternion_axes,
    scaled,
    times,
)
from yesnt.gaussians.compiled import entry, kernel
from yesnt.gaussians.compiled_harmonics import fill_basis

TILE = 8
"""Rows and columns of a tile."""

SPLAT = 18
"""Screen-space parameters of a Gaussian; the fields of `Splat`."""

OPACITY_CHANNEL, COLOR_CHANNEL, NORMAL_CHANNEL = 11, 12, 15


class Splat(NamedTuple):
    """A Gaussian as a view sees it.

    q = (n11 dx^2 + c12 dx dy + n22 dy^2) / den, t* = z (1 + h1 dx + h2 dy) / den,
    den = 1 + 2 h1 dx + 2 h2 dy + a11 dx^2 + a12 dx dy + a22 dy^2.
    """

    x: Any
    y: Any
    n11: Any
    c12: Any
    n22: Any
    h1: Any
    h2: Any
    a11: Any
    a12: Any
    a22: Any
    z: Any
    opacity: Any
    red: Any
    green: Any
    blue: Any
    nx: Any
    ny: Any
    nz: Any


class GaussianArrays(NamedTuple):
    """The arrays of a field (field.py) and `added` [N]: variance that the smoothing filter adds to each axis, m^2."""

    positions: Any
    log_scales: Any
    rotations: Any
    opacity_logits: Any
    harmonics: Any
    added: Any


class Pinhole(NamedTuple):
    """A view (records.py) as numbers; `reference_z` is subtracted from depths before they are squared."""

    rotation: Any
    position: Any
    fx: Any
    fy: Any
    cx: Any
    cy: Any
    width: Any
    height: Any
    near: Any
    reference_z: Any


class Projected(NamedTuple):
    """What `project` writes.

    Attributes:
        splats: [N, 18] float32 rows of `Splat`.
        boxes: [N, 6] int32: first tile column and one past the last, the same of tile rows, first pixel row and one
            past the last.
        tiles: [N] int32 number of tiles; 0 where nothing is seen.
    """

    splats: Any
    boxes: Any
    tiles: Any


class Shape(NamedTuple):
    """A Gaussian in camera axes."""

    center: Any
    axes: Any
    variances: Any
    covariance: Any
    adjugate: Any


@kernel
def shape_of(i: Any, gaussians: Any, pinhole: Any) -> Any:
    """Centre, axes, covariance and its adjugate of Gaussian i in camera axes."""
    p, c = gaussians.positions, pinhole.position
    center = into_camera(pinhole.rotation, (p[i, 0] - c[0], p[i, 1] - c[1], p[i, 2] - c[2]))
    _, w, x, y, z = normalised_quaternion(gaussians.rotations[i])
    a, b, c = quaternion_axes(w, x, y, z)
    axes = (into_camera(pinhole.rotation, a), into_camera(pinhole.rotation, b), into_camera(pinhole.rotation, c))
    s, added = gaussians.log_scales, gaussians.added[i]
    d = (math.exp(2.0 * s[i, 0]) + added, math.exp(2.0 * s[i, 1]) + added, math.exp(2.0 * s[i, 2]) + added)
    cofactors = (d[1] * d[2], d[0] * d[2], d[0] * d[1])
    return Shape(center, axes, d, from_axes(axes, d), from_axes(axes, cofactors))


@kernel
def opacity_of(i: Any, gaussians: Any, variances: Any) -> Any:
    """Opacity of Gaussian i, and by what the smoothing filter has multiplied it."""
    s, shrinkage = gaussians.log_scales, 1.0
    if gaussians.added[i] > 0:
        ratio = math.exp(2.0 * (s[i, 0] + s[i, 1] + s[i, 2])) / (variances[0] * variances[1] * variances[2])
        shrinkage = math.sqrt(ratio)
    return shrinkage / (1 + math.exp(-gaussians.opacity_logits[i])), shrinkage


@kernel
def tangents(shape: Any) -> Any:
    """The vectors u and w with mu x r = dx u + dy w, and r_mu."""
    mx, my, mz = shape.center
    x, y = mx / mz, my / mz
    return (0.0, mz, -mz * y), (-mz, 0.0, mz * x), (x, y, 1.0)


@kernel
def fill_row(i: Any, shape: Any, opacity: Any, row: Any) -> Any:
    """Writes the geometry of a Gaussian and its opacity to its row of splats."""
    u, w, r = tangents(shape)
    v = times(shape.adjugate, r)
    inverse = 1 / dot(r, v)
    su, sw = times(shape.covariance, u), times(shape.covariance, w)
    row[0], row[1] = r[0], r[1]
    row[2], row[3], row[4] = dot(u, su) * inverse, 2 * dot(u, sw) * inverse, dot(w, sw) * inverse
    row[5], row[6] = v[0] * inverse, v[1] * inverse
    g = shape.adjugate
    row[7], row[8], row[9] = g[0] * inverse, 2 * g[1] * inverse, g[3] * inverse
    row[10], row[11] = shape.center[2], opacity
    normal = scaled(-1 / math.sqrt(dot(v, v)), v)
    row[15], row[16], row[17] = normal


@kernel
def fill_color(i: Any, gaussians: Any, pinhole: Any, scratch: Any, row: Any) -> Any:
    """Writes the colour that the camera sees to a row of splats; scratch [16]."""
    p, c, sh = gaussians.positions, pinhole.position, gaussians.harmonics
    offset = (p[i, 0] - c[0], p[i, 1] - c[1], p[i, 2] - c[2])
    count = sh.shape[1]
    fill_basis(count, scaled(1 / math.sqrt(dot(offset, offset)), offset), scratch)
    for channel in range(3):
        value = 0.5
        for k in range(count):
            value += scratch[k] * sh[i, k, channel]
        row[12 + channel] = max(0.0, value)


@kernel
def limits(row: Any, q_max: Any, pinhole: Any) -> Any:
    """Pixel columns and rows (first, last) in which q can be at most q_max; empty where first > last.

    {q <= q_max} is an ellipse, or unbounded where the camera lies inside that isosurface: then the whole picture.
    """
    x0, x1, y0, y1 = 0.0, pinhole.width - 1.0, 0.0, pinhole.height - 1.0
    q11, q12, q22 = row[2] - q_max * row[7], 0.5 * (row[3] - q_max * row[8]), row[4] - q_max * row[9]
    determinant = q11 * q22 - q12 * q12
    if q11 > 0 and determinant > 0:
        i11, i12, i22 = q22 / determinant, -q12 / determinant, q11 / determinant
        ex, ey = q_max * (i11 * row[5] + i12 * row[6]), q_max * (i12 * row[5] + i22 * row[6])
        size = q_max * (1 + row[5] * ex + row[6] * ey)
        rx, ry = math.sqrt(size * i11) * pinhole.fx, math.sqrt(size * i22) * pinhole.fy
        x, y = (row[0] + ex) * pinhole.fx + pinhole.cx - 0.5, (row[1] + ey) * pinhole.fy + pinhole.cy - 0.5
        x0, x1 = max(math.ceil(x - rx), x0), min(math.floor(x + rx), x1)
        y0, y1 = max(math.ceil(y - ry), y0), min(math.floor(y + ry), y1)
    return x0, x1, y0, y1


@entry
def project(first: Any, last: Any, gaussians: Any, pinhole: Any, out: Any) -> Any:
    """Writes `Projected` for Gaussians [first, last)."""
    scratch, row = np.zeros(16), np.zeros(SPLAT)
    for i in range(first, last):
        out.tiles[i] = 0
        shape = shape_of(i, gaussians, pinhole)
        out.splats[i, 10] = shape.center[2]
        opacity, _ = opacity_of(i, gaussians, shape.variances)
        if shape.center[2] < pinhole.near or 255 * opacity <= 1:
            continue
        fill_row(i, shape, opacity, row)
        # The margin keeps pixels in which the float32 of the tile kernels is a little more generous.
        x0, x1, y0, y1 = limits(row, 2 * math.log(255 * opacity) * 1.0001 + 1e-5, pinhole)
        if not (x0 <= x1 and y0 <= y1):
            continue
        fill_color(i, gaussians, pinhole, scratch, row)
        for k in range(SPLAT):
            out.splats[i, k] = row[k]
        box = out.boxes[i]
        box[0], box[1], box[2], box[3] = int(x0) // TILE, int(x1) // TILE + 1, int(y0) // TILE, int(y1) // TILE + 1
        box[4], box[5] = int(y0), int(y1) + 1
        out.tiles[i] = (box[1] - box[0]) * (box[3] - box[2])
