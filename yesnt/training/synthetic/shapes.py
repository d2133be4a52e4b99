"""Primitives rasterised into a depth-tested geometry buffer (orthographic, the camera looks along -z)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.compiled import compiled

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]

EMPTY = -1
"""Index of the material of an empty pixel."""


@dataclass(frozen=True)
class GeometryBuffer:
    """Visible surface per pixel of the canvas.

    Attributes:
        z: [H, W] height towards the camera in pixels.
        normal: [H, W, 3] unit, x right, y down, z to the camera.
        uv: [H, W, 2] surface coordinates in pixels.
        material: [H, W] int32 index of the material, `EMPTY` for none.
    """

    z: Float32
    normal: Float32
    uv: Float32
    material: Int32

    @classmethod
    def empty(cls, size: int) -> GeometryBuffer:
        """Returns an empty canvas of size x size pixels."""
        return cls(
            np.full((size, size), -1e9, np.float32),
            np.zeros((size, size, 3), np.float32),
            np.zeros((size, size, 2), np.float32),
            np.full((size, size), EMPTY, np.int32),
        )

    def capsule(self, a: Float64, b: Float64, flat: float, material: int) -> None:
        """Draws a cone with spherical ends.

        Args:
            a: (x, y, z, radius) of one end, pixels.
            b: the other end.
            flat: depth of the cross-section over its width.
            material: index of the material.
        """
        _capsule(self.z, self.normal, self.uv, self.material, a, b, flat, material)

    def box(self, centre: Float64, half: Float64, turn: Float64, material: int) -> None:
        """Draws a box.

        Args:
            centre: (x, y, z) in pixels.
            half: half sizes [3] in pixels.
            turn: rotation [3, 3]; rows are the axes of the box.
            material: index of the material.
        """
        _box(self.z, self.normal, self.uv, self.material, centre, half, turn, material)

    def sheet(self, plane: Float64, waves: Float64, material: int) -> None:
        """Draws a folded sheet.

        Args:
            plane: (x, y, z, half width, half height, angle in the image).
            waves: [n, 4] of (wave vector x, y in radians per pixel, phase, height in pixels).
            material: index of the material.
        """
        _sheet(self.z, self.normal, self.uv, self.material, plane, waves, material)


@compiled()
def _capsule(
    z: Float32, normal: Float32, uv: Float32, material: Int32, a: Float64, b: Float64, flat: float, number: int
) -> None:
    size = z.shape[0]
    ax, ay, az = b[0] - a[0], b[1] - a[1], (b[2] - a[2]) / flat
    slope = b[3] - a[3]
    # Points of the axis within reach: q(t) = r(t)^2 - |p - c(t)|^2 in the image plane = top - bend (t - t0)^2.
    bend = max(ax * ax + ay * ay - slope * slope, 1e-6)
    length = math.sqrt(ax * ax + ay * ay + az * az) + 1e-9
    reach = max(a[3], b[3])
    x0, x1 = int(max(0, min(a[0], b[0]) - reach)), int(min(size - 1, max(a[0], b[0]) + reach))
    y0, y1 = int(max(0, min(a[1], b[1]) - reach)), int(min(size - 1, max(a[1], b[1]) + reach))
    ex, ey, ez = ax / length, ay / length, az / length
    # A side direction, for the angle around the axis.
    sx, sy = -ey, ex
    norm = math.sqrt(sx * sx + sy * sy)
    if norm < 1e-6:
        sx, sy, norm = 1.0, 0.0, 1.0
    sx, sy = sx / norm, sy / norm
    bx, by, bz = -sy * ez, sx * ez, sy * ex - sx * ey
    for i in range(y0, y1 + 1):
        for j in range(x0, x1 + 1):
            px, py = j + 0.5 - a[0], i + 0.5 - a[1]
            linear = px * ax + py * ay + a[3] * slope
            t0 = linear / bend
            top = a[3] * a[3] - px * px - py * py + bend * t0 * t0
            if top <= 0:
                continue
            half = math.sqrt(top / bend)
            low, high = max(0.0, t0 - half), min(1.0, t0 + half)
            if low > high:
                continue
            t = t0 + az * math.sqrt(top / (bend * (bend + az * az)))
            t = min(max(t, low), high)
            q = max(0.0, top - bend * (t - t0) ** 2)
            up = math.sqrt(q)
            depth = a[2] + flat * (az * t + up)
            if depth <= z[i, j]:
                continue
            radius = a[3] + slope * t + 1e-9
            nx, ny, nz = (px - ax * t) / radius, (py - ay * t) / radius, up / radius / flat
            angle = math.atan2(nx * bx + ny * by + nz * bz, nx * sx + ny * sy)
            scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-12)
            z[i, j] = depth
            normal[i, j, 0], normal[i, j, 1], normal[i, j, 2] = nx * scale, ny * scale, nz * scale
            along = t * length + radius * (nx * ex + ny * ey + nz * ez)
            uv[i, j, 0], uv[i, j, 1] = angle * 0.5 * (a[3] + b[3]), along
            material[i, j] = number


@compiled()
def _box(
    z: Float32,
    normal: Float32,
    uv: Float32,
    material: Int32,
    centre: Float64,
    half: Float64,
    turn: Float64,
    number: int,
) -> None:
    size = z.shape[0]
    reach = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    x0, x1 = int(max(0, centre[0] - reach)), int(min(size - 1, centre[0] + reach))
    y0, y1 = int(max(0, centre[1] - reach)), int(min(size - 1, centre[1] + reach))
    for i in range(y0, y1 + 1):
        for j in range(x0, x1 + 1):
            near, face = -1e9, -1
            far = 1e9
            px, py = j + 0.5 - centre[0], i + 0.5 - centre[1]
            hit = True
            for k in range(3):
                origin = turn[k, 0] * px + turn[k, 1] * py
                step = turn[k, 2]
                if abs(step) < 1e-6:
                    if abs(origin) > half[k]:
                        hit = False
                    continue
                s0, s1 = (-half[k] - origin) / step, (half[k] - origin) / step
                if s0 > s1:
                    s0, s1 = s1, s0
                near = max(near, s0)
                if s1 < far:
                    far, face = s1, k
            if not hit or near > far or face < 0 or centre[2] + far <= z[i, j]:
                continue
            side = 1.0 if turn[face, 2] > 0 else -1.0
            z[i, j] = centre[2] + far
            other, third = (face + 1) % 3, (face + 2) % 3
            for c in range(3):
                normal[i, j, c] = side * turn[face, c]
            uv[i, j, 0] = turn[other, 0] * px + turn[other, 1] * py + turn[other, 2] * far
            uv[i, j, 1] = turn[third, 0] * px + turn[third, 1] * py + turn[third, 2] * far
            material[i, j] = number


@compiled()
def _sheet(
    z: Float32, normal: Float32, uv: Float32, material: Int32, plane: Float64, waves: Float64, number: int
) -> None:
    size = z.shape[0]
    c, s = math.cos(plane[5]), math.sin(plane[5])
    reach = math.hypot(plane[3], plane[4])
    x0, x1 = int(max(0, plane[0] - reach)), int(min(size - 1, plane[0] + reach))
    y0, y1 = int(max(0, plane[1] - reach)), int(min(size - 1, plane[1] + reach))
    for i in range(y0, y1 + 1):
        for j in range(x0, x1 + 1):
            px, py = j + 0.5 - plane[0], i + 0.5 - plane[1]
            u, v = c * px + s * py, -s * px + c * py
            if abs(u) > plane[3] or abs(v) > plane[4]:
                continue
            height, gx, gy = plane[2], 0.0, 0.0
            for k in range(waves.shape[0]):
                phase = waves[k, 0] * px + waves[k, 1] * py + waves[k, 2]
                height += waves[k, 3] * math.sin(phase)
                slope = waves[k, 3] * math.cos(phase)
                gx += slope * waves[k, 0]
                gy += slope * waves[k, 1]
            if height <= z[i, j]:
                continue
            z[i, j] = height
            scale = 1.0 / math.sqrt(gx * gx + gy * gy + 1.0)
            normal[i, j, 0], normal[i, j, 1], normal[i, j, 2] = -gx * scale, -gy * scale, scale
            uv[i, j, 0], uv[i, j, 1] = u, v
            material[i, j] = number
