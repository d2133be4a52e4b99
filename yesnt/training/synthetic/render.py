"""Paints and shades a geometry buffer: textures, bumps, GGX under prefiltered light, ambient occlusion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from yesnt.core.compiled import compiled
from yesnt.training.synthetic.light import LEVELS, Light, environment_brdf
from yesnt.training.synthetic.shapes import GeometryBuffer
from yesnt.training.synthetic.tiles import tile_bank, tile_index

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]


@dataclass(frozen=True)
class Rendering:
    """A rendered image with its ground truth.

    Attributes:
        rgb: [3, H, W] linear Rec.709, associated.
        matte: [H, W] coverage in [0, 1].
        truth: [2, H, W] roughness and metallic, straight, antialiased; 0 outside the matte.
        kind: [H, W] int64 material class, -1 outside the matte.
    """

    rgb: Float32
    matte: Float32
    truth: Float32
    kind: NDArray[np.int64]


def render(geometry: GeometryBuffer, materials: NDArray[np.void], light: Light) -> Rendering:
    """Shades a canvas and averages 2 x 2 pixels.

    Args:
        geometry: canvas of 2H x 2W pixels.
        materials: [n] record array of `MATERIAL`.
        light: capture light.

    Returns:
        Image of H x W pixels.
    """
    painted = paint_surface(geometry.normal, geometry.uv, geometry.material, materials)
    out = np.zeros((5, *geometry.z.shape), np.float32)
    tables = (light.diffuse, light.specular, environment_brdf())
    _shade(painted, geometry.material, _ambient_occlusion(geometry), tables, LEVELS[0], out)
    out[3:] = painted[3:5]
    covered = _halved((geometry.material >= 0).astype(np.float32)[None])[0]
    planes = _halved(out)
    number = geometry.material[::2, ::2]
    return Rendering(planes[:3], covered, planes[3:] / np.maximum(covered, 1e-6), material_class(number, materials))


def material_class(number: Int32, materials: NDArray[np.void]) -> NDArray[np.int64]:
    """Returns the material class of every pixel [H, W], -1 outside the subject.

    Args:
        number: [H, W] index of the material, -1 outside the subject.
        materials: [n] record array of `MATERIAL`.
    """
    return np.where(number >= 0, materials["kind"][number], -1).astype(np.int64)


def paint_surface(normal: Float32, uv: Float32, material: Int32, materials: NDArray[np.void]) -> Float32:
    """Evaluates the materials at every pixel.

    Args:
        normal: [H, W, 3] unit, x right, y down, z to the camera.
        uv: [H, W, 2] surface coordinates in pixels.
        material: [H, W] index of the material, -1 outside the subject.
        materials: [n] record array of `MATERIAL`.

    Returns:
        [8, H, W] base colour (3), roughness, metallic, bumped normal (3).
    """
    tiles = tile_bank()
    slow, fold = tiles[tile_index("mottled")], tiles[tile_index("cloudy")]
    textures = np.zeros((3, *material.shape), np.float32)
    _texture(uv, material, materials, tiles, slow, fold, textures)
    painted = np.zeros((8, *material.shape), np.float32)
    _paint(normal, material, materials, textures, painted)
    return painted


def _halved(planes: Float32) -> Float32:
    rows = planes[:, 0::2] + planes[:, 1::2]
    return (rows[:, :, 0::2] + rows[:, :, 1::2]) * np.float32(0.25)


def _ambient_occlusion(geometry: GeometryBuffer) -> Float32:
    """Approximate occlusion of pixels that lie behind their surroundings: z against its local mean at two sizes."""
    covered = geometry.material >= 0
    if not covered.any():
        return np.ones_like(geometry.z)
    size = geometry.z.shape[0]
    open_air = 1 - 0 * geometry.z
    for share in (0.03, 0.1):
        radius = share * size
        z = np.where(covered, geometry.z, geometry.z[covered].min() - size)
        limited = cv2.blur(z, (int(2 * radius) | 1,) * 2)
        open_air *= 1 - 0.45 * np.clip((limited - z) / radius, 0, 1)
    return open_air.astype(np.float32)


@compiled(fastmath=True)
def _bilinear(tile: Float32, u: float, v: float) -> float:
    size = tile.shape[0]
    fu, fv = math.floor(u), math.floor(v)
    du, dv = u - fu, v - fv
    i, j = int(fv) % size, int(fu) % size
    i2, j2 = (i + 1) % size, (j + 1) % size
    upper = tile[i, j] * (1 - du) + tile[i, j2] * du
    lower = tile[i2, j] * (1 - du) + tile[i2, j2] * du
    return upper * (1 - dv) + lower * dv


@compiled(fastmath=True)
def _texture(
    uv: Float32, material: Int32, materials: Any, tiles: Float32, slow: Float32, fold: Float32, out: Float32
) -> None:
    """Writes fine pattern, slow noise and bump height [3, H, W]."""
    height, width = material.shape
    for i in range(height):
        for j in range(width):
            number = material[i, j]
            if number < 0:
                continue
            m = materials[number]
            u, v = uv[i, j, 0] + 37.0 * number, uv[i, j, 1] + 71.0 * number
            c, s = math.cos(m.turn), math.sin(m.turn)
            a, b = (c * u + s * v) * m.frequency, (c * v - s * u) * m.frequency
            fine = _bilinear(tiles[m.pattern], a, b)
            out[0, i, j] = fine
            out[1, i, j] = _bilinear(slow, u * m.slow, v * m.slow)
            out[2, i, j] = m.bump * fine
            if m.fold > 0:
                out[2, i, j] += m.fold * _bilinear(fold, 1.7 * u * m.fold_frequency, v * m.fold_frequency)


@compiled(fastmath=True)
def _place(x: float, y: float, z: float, h: int, w: int) -> Any:
    """Texel column and row of a direction in a lat-long map, and the fractions."""
    v = math.acos(min(1.0, max(-1.0, -y))) / math.pi * h - 0.5
    u = (math.atan2(x, z) / (2 * math.pi) + 0.5) * w - 0.5
    fu, fv = math.floor(u), math.floor(v)
    return int(fu), int(fv), u - fu, v - fv


@compiled(fastmath=True)
def _lookup(table: Float32, place: Any, c: int) -> float:
    """Bilinear sample of channel c of a lat-long map [h, w, 3]."""
    h, w = table.shape[0], table.shape[1]
    fu, fv, du, dv = place
    j, j2 = fu % w, (fu + 1) % w
    i, i2 = min(max(fv, 0), h - 1), min(max(fv + 1, 0), h - 1)
    upper = table[i, j, c] * (1 - du) + table[i, j2, c] * du
    lower = table[i2, j, c] * (1 - du) + table[i2, j2, c] * du
    return upper * (1 - dv) + lower * dv


@compiled(fastmath=True)
def _slope(heights: Float32, material: Int32, i: int, j: int, axis: int) -> float:
    """Central difference of the bump height within one material, limited to +-0.9."""
    number = material[i, j]
    i1, j1, i0, j0 = i, j, i, j
    if axis == 0:
        j1, j0 = min(j + 1, material.shape[1] - 1), max(j - 1, 0)
    else:
        i1, i0 = min(i + 1, material.shape[0] - 1), max(i - 1, 0)
    if material[i1, j1] != number or material[i0, j0] != number:
        return 0.0
    return min(0.9, max(-0.9, 0.5 * (heights[i1, j1] - heights[i0, j0])))


@compiled(fastmath=True)
def _paint(normals: Float32, material: Int32, materials: Any, textures: Float32, out: Float32) -> None:
    """Writes base colour (3), roughness, metallic and bumped normal (3): [8, H, W], 0 outside the subject."""
    for i in range(material.shape[0]):
        for j in range(material.shape[1]):
            if material[i, j] < 0:
                continue
            m = materials[material[i, j]]
            fine, slow = textures[0, i, j], textures[1, i, j]
            nx = normals[i, j, 0] - _slope(textures[2], material, i, j, 0)
            ny = normals[i, j, 1] - _slope(textures[2], material, i, j, 1)
            nz = max(normals[i, j, 2], 0.03)
            scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
            metallic = m.metallic
            roughness = m.roughness + m.roughness_pattern * fine + m.roughness_slow * slow
            mix = m.contrast * min(1.0, max(0.0, 0.5 + 0.5 * fine))
            if m.patina > 0 and slow > 0.8 - 1.9 * m.patina:
                metallic, roughness = 0.0, roughness + 0.3
                mix = 1.0
            for c in range(3):
                base = (m.base[c] + mix * (m.second[c] - m.base[c])) * max(0.1, 1 + m.mottle * slow)
                out[c, i, j] = min(0.98, max(0.002, base))
            out[3, i, j], out[4, i, j] = min(1.0, max(0.02, roughness)), metallic
            out[5, i, j], out[6, i, j], out[7, i, j] = nx * scale, ny * scale, nz * scale


@compiled(fastmath=True)
def _shade(painted: Float32, material: Int32, occlusion: Float32, tables: Any, lowest: float, out: Float32) -> None:
    """Writes radiance [3, H, W] of painted pixels, 0 outside the subject."""
    diffuse_map, specular_map, albedo_table = tables
    levels, size = specular_map.shape[0], albedo_table.shape[0]
    h, w = diffuse_map.shape[0], diffuse_map.shape[1]
    for i in range(material.shape[0]):
        for j in range(material.shape[1]):
            if material[i, j] < 0:
                continue
            roughness, metallic = painted[3, i, j], painted[4, i, j]
            nx, ny, nz = painted[5, i, j], painted[6, i, j], painted[7, i, j]
            facing = _place(nx, ny, nz, h, w)
            mirrored = _place(2 * nz * nx, 2 * nz * ny, 2 * nz * nz - 1, h, w)
            level = (roughness - lowest) / (1 - lowest) * (levels - 1)
            below = min(levels - 2, max(0, int(level)))
            part = min(1.0, max(0.0, level - below))
            row, column = min(size - 1, int(nz * size)), min(size - 1, int(roughness * size))
            scale_f0, bias = albedo_table[row, column, 0], albedo_table[row, column, 1]
            # Energy lost between microfacets comes back tinted (Fdez-Aguera 2019); keeps rough metal bright.
            missing = 1 - scale_f0 - bias
            for c in range(3):
                base = painted[c, i, j]
                f0 = 0.04 * (1 - metallic) + base * metallic
                single = f0 * scale_f0 + bias
                average = f0 + (1 - f0) / 21
                reflect = single + missing * single * average / (1 - missing * average)
                low, high = _lookup(specular_map[below], mirrored, c), _lookup(specular_map[below + 1], mirrored, c)
                specular = (low + part * (high - low)) * reflect
                body = (1 - metallic) * base * (1 - reflect) * _lookup(diffuse_map, facing, c)
                out[c, i, j] = occlusion[i, j] * (body + specular)
