"""Gradients of a field's arrays from those of its splats: the chain rule through project.py, one Gaussian at a time."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from yesnt.gaussians.algebra import (
    added,
    dot,
    into_world,
    outer,
    quaternion_gradient,
    scaled,
    sum_of,
    times,
)
from yesnt.gaussians.backward import SUMS
from yesnt.gaussians.compiled import entry, kernel
from yesnt.gaussians.compiled_harmonics import direction_gradient, fill_basis
from yesnt.gaussians.project import COLOR_CHANNEL, opacity_of, shape_of, tangents


class FieldGradient(NamedTuple):
    """Gradients of the arrays of a field, float32, and the length of the gradient by each centre on the plane z = 1.

    `screen` [N] is 0 where a Gaussian had no effect; splitting looks at it.
    """

    positions: Any
    log_scales: Any
    rotations: Any
    opacity_logits: Any
    harmonics: Any
    screen: Any


class ShapeGradient(NamedTuple):
    """Gradients by the centre in camera axes (3), the covariance and its adjugate (symmetric, 6 each)."""

    center: Any
    covariance: Any
    adjugate: Any


@kernel
def shape_gradient(shape: Any, m: Any) -> Any:
    """Gradients of a Gaussian in camera axes from its sums m [21], and the length of that by its place on screen."""
    u, w, r = tangents(shape)
    s, g, mz = shape.covariance, shape.adjugate, shape.center[2]
    v = times(g, r)
    inverse = 1 / dot(r, v)
    su, sw = times(s, u), times(s, w)
    n11, c12, n22 = dot(u, su) * inverse, 2 * dot(u, sw) * inverse, dot(w, sw) * inverse
    a1, a2 = 2 * v[0] * inverse, 2 * v[1] * inverse
    a11, a12, a22 = g[0] * inverse, 2 * g[1] * inverse, g[3] * inverse
    x = -(2 * n11 * m[0] + c12 * m[1] + a1 * m[5] + 2 * a11 * m[8] + a12 * m[9])
    y = -(c12 * m[0] + 2 * n22 * m[1] + a2 * m[5] + a12 * m[8] + 2 * a22 * m[9])
    screen = math.sqrt(x * x + y * y)
    scale = n11 * m[2] + c12 * m[3] + n22 * m[4] + a1 * m[6] + a2 * m[7] + a11 * m[10] + a12 * m[11] + a22 * m[12]
    by_norm = -scale * inverse
    length = 1 / math.sqrt(dot(v, v))
    by_normal = (m[18], m[19], m[20])
    by_v = scaled(-length, added(by_normal, scaled(-dot(v, by_normal) * length * length, v)))
    by_v = added(added(by_v, scaled(by_norm, r)), (2 * m[6] * inverse, 2 * m[7] * inverse, 0.0))
    by_r = added(scaled(by_norm, v), times(g, by_v))
    by_covariance = sum_of(outer(m[2] * inverse, u, u), outer(m[4] * inverse, w, w))
    by_covariance = sum_of(by_covariance, outer(2 * m[3] * inverse, u, w))
    by_u = added(scaled(2 * m[2] * inverse, su), scaled(2 * m[3] * inverse, sw))
    by_w = added(scaled(2 * m[4] * inverse, sw), scaled(2 * m[3] * inverse, su))
    by_adjugate = outer(1.0, by_v, r)
    by_adjugate = sum_of(by_adjugate, (m[10] * inverse, m[11] * inverse, 0.0, m[12] * inverse, 0.0, 0.0))
    x += by_r[0] + mz * by_w[2]
    y += by_r[1] - mz * by_u[2]
    z = m[13] / mz + by_u[1] - r[1] * by_u[2] - by_w[0] + r[0] * by_w[2]
    center = (x / mz, y / mz, z - (r[0] * x + r[1] * y) / mz)
    return ShapeGradient(center, by_covariance, by_adjugate), screen


@kernel
def axis_gradient(shape: Any, by: Any, axis: Any) -> Any:
    """Gradients by a Gaussian's axis (a vector) and by its variance and cofactor along that axis."""
    a, d = shape.axes[axis], shape.variances
    cofactor = d[1] * d[2] if axis == 0 else (d[0] * d[2] if axis == 1 else d[0] * d[1])
    of_s, of_g = times(by.covariance, a), times(by.adjugate, a)
    return added(scaled(2 * d[axis], of_s), scaled(2 * cofactor, of_g)), dot(a, of_s), dot(a, of_g)


@kernel
def write_shape(i: Any, gaussians: Any, pinhole: Any, shape: Any, by: Any, m: Any, out: Any) -> Any:
    """Writes the gradients of centre, scales, rotation and opacity of Gaussian i."""
    a, da, ka = axis_gradient(shape, by, 0)
    b, db, kb = axis_gradient(shape, by, 1)
    c, dc, kc = axis_gradient(shape, by, 2)
    d = shape.variances
    by_variance = (da + kb * d[2] + kc * d[1], db + ka * d[2] + kc * d[0], dc + ka * d[1] + kb * d[0])
    rotation = pinhole.rotation
    quaternion = quaternion_gradient(
        gaussians.rotations[i], into_world(rotation, a), into_world(rotation, b), into_world(rotation, c)
    )
    for k in range(4):
        out.rotations[i, k] = quaternion[k]
    opacity, shrinkage = opacity_of(i, gaussians, d)
    plain = opacity / shrinkage
    out.opacity_logits[i] = m[14] * opacity * (1 - plain)
    for k in range(3):
        own = math.exp(2.0 * gaussians.log_scales[i, k])
        # The smoothing filter lowers the opacity by sqrt(prod own / d), whose logarithm grows by 1 - own / d.
        out.log_scales[i, k] = 2 * own * by_variance[k] + m[14] * opacity * (1 - own / d[k])
    world = into_world(rotation, by.center)
    for k in range(3):
        out.positions[i, k] = world[k]


@kernel
def write_color(i: Any, gaussians: Any, pinhole: Any, splat: Any, m: Any, scratch: Any, out: Any) -> Any:
    """Writes the gradients of the harmonics of Gaussian i and adds what the direction is worth; scratch [32]."""
    p, c, sh = gaussians.positions, pinhole.position, gaussians.harmonics
    offset = (p[i, 0] - c[0], p[i, 1] - c[1], p[i, 2] - c[2])
    inverse, count = 1 / math.sqrt(dot(offset, offset)), sh.shape[1]
    d = scaled(inverse, offset)
    fill_basis(count, d, scratch)
    weights = scratch[16:]
    for k in range(count):
        weights[k] = 0.0
    for channel in range(3):
        by_channel = m[15 + channel] if splat[COLOR_CHANNEL + channel] > 0 else 0.0
        for k in range(count):
            out.harmonics[i, k, channel] = scratch[k] * by_channel
            weights[k] += sh[i, k, channel] * by_channel
    by_d = direction_gradient(count, d, weights)
    by_offset = scaled(inverse, added(by_d, scaled(-dot(by_d, d), d)))
    for k in range(3):
        out.positions[i, k] += by_offset[k]


@entry
def unproject(
    first: Any, last: Any, gaussians: Any, pinhole: Any, projected: Any, lists: Any, sums: Any, out: Any
) -> Any:
    """Writes `FieldGradient` for Gaussians [first, last), whose arrays are 0 before, from the sums of all slots."""
    m, scratch = np.zeros(SUMS), np.zeros(32)
    for i in range(first, last):
        m[:] = 0.0
        for slot in range(lists.own[i], lists.own[i + 1]):
            for k in range(SUMS):
                m[k] += sums[slot, k]
        some = False
        for k in range(SUMS):
            some |= m[k] != 0
        if not some:
            continue
        shape = shape_of(i, gaussians, pinhole)
        by, out.screen[i] = shape_gradient(shape, m)
        write_shape(i, gaussians, pinhole, shape, by, m, out)
        write_color(i, gaussians, pinhole, projected.splats[i], m, scratch, out)
