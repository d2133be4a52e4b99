"""Losses of depth and normals with their gradients, compiled (loss_reference.py states them)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from yesnt.gaussians.algebra import dot, scaled
from yesnt.gaussians.compiled import entry, kernel


class Geometry(NamedTuple):
    """Images of a crop and its camera's numbers.

    Attributes:
        z: [H, W] planar depth over the subject's height.
        normal: [H, W, 3] unit normals in camera axes, 0 where there is none.
        solid: [H, W] pixels that are regularised.
        edges: [H, W] weights of L_normal.
        fx, fy, cx, cy: of the camera, pixels.
    """

    z: Any
    normal: Any
    solid: Any
    edges: Any
    fx: Any
    fy: Any
    cx: Any
    cy: Any


class GeometryWeights(NamedTuple):
    """Weights of the three losses over the matte's sum, and the constants delta and jump."""

    consistency: Any
    depth: Any
    normal: Any
    delta: Any
    jump: Any


@kernel
def surrounded(solid: Any, y: Any, x: Any) -> Any:
    """Whether an inner pixel and its four neighbours are solid."""
    return solid[y, x] and solid[y - 1, x] and solid[y + 1, x] and solid[y, x - 1] and solid[y, x + 1]


@kernel
def huber_step(g: Any, w: Any, y: Any, x: Any, v: Any, u: Any, by_z: Any) -> Any:
    """L_depth of the neighbours (y, x) and (v, u); adds its gradient."""
    if not (g.solid[y, x] and g.solid[v, u]):
        return 0.0
    d = g.z[v, u] - g.z[y, x]
    if abs(d) >= w.jump:
        return 0.0
    slope = max(min(d, w.delta), -w.delta)
    by_z[v, u] += w.depth * slope
    by_z[y, x] -= w.depth * slope
    return slope * d - 0.5 * slope * slope


@kernel
def laplacian_at(g: Any, w: Any, y: Any, x: Any, by_normal: Any) -> Any:
    """L_normal of a surrounded pixel; adds its gradient."""
    n, total, weight = g.normal, 0.0, g.edges[y, x]
    for k in range(3):
        value = n[y - 1, x, k] + n[y + 1, x, k] + n[y, x - 1, k] + n[y, x + 1, k] - 4.0 * n[y, x, k]
        total += value * value
        by = 2.0 * w.normal * weight * value
        by_normal[y - 1, x, k] += by
        by_normal[y + 1, x, k] += by
        by_normal[y, x - 1, k] += by
        by_normal[y, x + 1, k] += by
        by_normal[y, x, k] -= 4.0 * by
    return weight * total


@kernel
def ray(g: Any, y: Any, x: Any) -> Any:
    """The ray through a pixel, z = 1."""
    return ((x + 0.5 - g.cx) / g.fx, (y + 0.5 - g.cy) / g.fy, 1.0)


@kernel
def span(a: Any, za: Any, b: Any, zb: Any) -> Any:
    """The vector from the point at depth za on the ray a to that at depth zb on the ray b."""
    return (zb * b[0] - za * a[0], zb * b[1] - za * a[1], zb - za)


@kernel
def cross(a: Any, b: Any) -> Any:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def consistency_at(g: Any, w: Any, y: Any, x: Any, by_z: Any, by_normal: Any) -> Any:
    """1 - n . n_depth of a surrounded pixel; adds its gradients."""
    left, right, up, low = ray(g, y, x - 1), ray(g, y, x + 1), ray(g, y - 1, x), ray(g, y + 1, x)
    across = span(left, g.z[y, x - 1], right, g.z[y, x + 1])
    down = span(up, g.z[y - 1, x], low, g.z[y + 1, x])
    if abs(across[2]) >= 2.0 * w.jump or abs(down[2]) >= 2.0 * w.jump:
        return 0.0
    c = cross(down, across)
    length = math.sqrt(dot(c, c))
    if length < 1e-12:
        return 1.0
    unit = scaled(1.0 / length, c)
    n = (g.normal[y, x, 0], g.normal[y, x, 1], g.normal[y, x, 2])
    cosine = dot(n, unit)
    for k in range(3):
        by_normal[y, x, k] -= w.consistency * unit[k]
    s = -w.consistency / length  # gradient by c: s (n - cosine unit)
    by_c = (s * (n[0] - cosine * unit[0]), s * (n[1] - cosine * unit[1]), s * (n[2] - cosine * unit[2]))
    by_down, by_across = cross(across, by_c), cross(by_c, down)
    by_z[y, x + 1] += dot(by_across, right)
    by_z[y, x - 1] -= dot(by_across, left)
    by_z[y + 1, x] += dot(by_down, low)
    by_z[y - 1, x] -= dot(by_down, up)
    return 1.0 - cosine


@entry
def geometry_losses(g: Any, w: Any, by_z: Any, by_normal: Any) -> Any:
    """Unweighted sums of consistency, L_depth and L_normal; adds the weighted gradients to by_z and by_normal.

    One thread, in the order of the rows: neighbours add to each other's gradients.
    """
    height, width = g.z.shape
    consistency, depth, normal = 0.0, 0.0, 0.0
    for y in range(height):
        for x in range(width):
            if not g.solid[y, x]:
                continue
            if w.depth > 0:
                if x + 1 < width:
                    depth += huber_step(g, w, y, x, y, x + 1, by_z)
                if y + 1 < height:
                    depth += huber_step(g, w, y, x, y + 1, x, by_z)
            if 0 < y < height - 1 and 0 < x < width - 1 and surrounded(g.solid, y, x):
                if w.normal > 0:
                    normal += laplacian_at(g, w, y, x, by_normal)
                if w.consistency > 0:
                    consistency += consistency_at(g, w, y, x, by_z, by_normal)
    return consistency, depth, normal
