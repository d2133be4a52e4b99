"""A painted sphere and its pictures by several cameras, by a full sum in float64 that shares no kernel with yesnt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yesnt.core.camera import Camera
from yesnt.decompose.evidence.frame import EvidenceInputs
from yesnt.decompose.evidence.records import View
from yesnt.relight import EnvMap, ProxyScene, RelightSettings, Surface
from yesnt.relight.albedo import energy_terms, multiple_scattering
from yesnt.relight.brdf import alpha_ggx, dielectric_fresnel, ggx_distribution, schlick_weight, smith_visibility
from yesnt.relight.envmap import uv_to_direction
from yesnt.relight.frame import prepare_capture

FRAME = 7
RELIGHT = RelightSettings(capture_texels=512, capture_clusters=128)

PAINT = (
    (0.35, 0.0, (0.5, 0.2, 0.1)),
    (0.5, 1.0, (0.8, 0.6, 0.3)),
    (0.85, 0.0, (0.2, 0.35, 0.5)),
    (0.35, 1.0, (0.7, 0.7, 0.75)),
)
"""Roughness, metallic and base colour of four bands along x. Sharper lobes fall between the texels of the sum."""


MIRROR = 0.1
"""Roughness of a metal below which it is painted as a mirror."""


@dataclass(frozen=True)
class Painted:
    """Materials [...] of points."""

    roughness: np.ndarray
    metallic: np.ndarray
    base: np.ndarray


def paint(position, bands=PAINT):
    """Materials of points [..., 3] of the unit sphere, in equal bands along x."""
    which = np.clip(((position[..., 0] + 1) / 2 * len(bands)).astype(int), 0, len(bands) - 1)
    return Painted(*(np.array([band[i] for band in bands], float)[which] for i in range(3)))


def look_from(direction, size, distance=4.0):
    """Camera that looks at the origin from a direction, Z up."""
    back = np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross([0, 0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, -np.cross(back, right), -back, distance * back], axis=1)
    return Camera(size, size, 1.7 * size, 1.7 * size, size / 2, size / 2, {FRAME: pose})


def around(count):
    """Directions of cameras about the delivered view (-Y), at three elevations."""
    azimuth = np.radians(-90 + np.linspace(-75, 75, count) if count > 1 else np.array([-60.0]))
    elevation = np.radians(np.resize([10, 45, -25], count))
    return np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1)


def smooth_light(strength=0.8, rows=24):
    """A smooth directional light of mean radiance 1; strength 0 is uniform."""
    u, v = np.meshgrid((np.arange(2 * rows) + 0.5) / (2 * rows), (np.arange(rows) + 0.5) / rows)
    d = uv_to_direction(u, v)
    level = 1 + strength * (0.5 * d[..., 2] + 0.6 * d[..., 0] * d[..., 1] - 0.4 * d[..., 1] + 0.5 * d[..., 0] ** 3)
    return EnvMap.from_array(np.clip(level, 0.05, None)[..., None] * [1.0, 0.97, 0.94])


def radiance(normal, view, painted, env):
    """Full sum over the map [P, 3], from docs/method.md section 5, `brdf="default"`; mirrors reflect the map."""
    if (painted.roughness < MIRROR).all():
        cos_o = (normal * view).sum(-1, keepdims=True)
        fresnel = painted.base + (1 - painted.base) * schlick_weight(cos_o)
        return fresnel * env.lookup((2 * cos_o * normal - view).astype(np.float32))
    rows, columns, _ = env.radiance.shape
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    light = uv_to_direction(u, v).reshape(-1, 3)
    edges = np.cos(np.linspace(0, np.pi, rows + 1))
    solid = np.repeat((edges[:-1] - edges[1:]) * 2 * np.pi / columns, columns)
    energy = env.radiance.reshape(-1, 3).astype(float) * solid[:, None]
    out = np.zeros((len(normal), 3))
    for first in range(0, len(normal), 128):
        part = slice(first, first + 128)
        few = Painted(painted.roughness[part], painted.metallic[part], painted.base[part])
        out[part] = _sum(normal[part], view[part], few, light, energy)
    return out


def _sum(normal, view, painted, light, energy):
    cos_i, cos_o = np.maximum(normal @ light.T, 0), np.maximum((normal * view).sum(-1), 1e-3)[:, None]
    half = light[None] + view[:, None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    cos_h, cos_d = (normal[:, None] * half).sum(-1), (view[:, None] * half).sum(-1)
    alpha = alpha_ggx(painted.roughness)[:, None]
    lobe = ggx_distribution(np.maximum(cos_h, 0), alpha) * smith_visibility(cos_i, cos_o, alpha) * cos_i
    terms, m = energy_terms(painted.roughness, cos_o[:, 0]), painted.metallic[:, None]
    weight = schlick_weight(cos_d)
    f0, f90 = (lobe * (1 - weight)) @ energy, (lobe * weight) @ energy
    single = painted.base + (1 - painted.base) / 21
    factor = 1 + multiple_scattering(single, terms.average[:, None]) * terms.missing[:, None]
    dielectric = terms.dielectric[:, None] * ((lobe * dielectric_fresnel(cos_d)) @ energy)
    diffuse = terms.layer[:, None] * painted.base * (cos_i @ energy) / np.pi
    return (1 - m) * (diffuse + dielectric) + m * factor * (painted.base * f0 + f90)


def picture(camera, env, bands=PAINT, shade=None):
    """Picture of the painted unit sphere: radiance [H, W, 3], matte, normal, planar z, materials."""
    rays, eye = camera.rays(FRAME).astype(np.float64), camera.position(FRAME)
    length = np.linalg.norm(rays, axis=-1)
    along = rays / length[..., None]
    middle = -(along @ eye)
    inside = middle**2 - (eye @ eye - 1)
    hit = inside > 0
    distance = np.where(hit, middle - np.sqrt(np.maximum(inside, 0)), 0)
    normal = np.where(hit[..., None], eye + along * distance[..., None], 0)
    painted = paint(normal, bands)
    color = np.zeros((*hit.shape, 3), np.float32)
    one = Painted(painted.roughness[hit], painted.metallic[hit], painted.base[hit])
    color[hit] = (shade or radiance)(normal[hit], -along[hit], one, env)
    z = np.where(hit, distance / length, 1e10)
    return color, hit.astype(np.float32), normal.astype(np.float32), z.astype(np.float32), painted


def proxy():
    """The unit sphere as triangles."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    return ProxyScene.from_arrays(mesh.vertices, mesh.faces)


def inputs(directions, env, size=32, bands=PAINT, guess=(0.5, 0.3), spread=0.1, shade=None):
    """Inputs of the evidence with cameras from these directions, and the painted materials of the plate."""
    camera = look_from([0, -1, 0.05], size)
    color, matte, normal, z, painted = picture(camera, env, bands, shade)
    full = np.ones(matte.shape, np.float32)
    surface = Surface(normal, z, matte, guess[0] * full, guess[1] * full, camera, FRAME)
    views = []
    for number, direction in enumerate(directions):
        other = look_from(direction, size)
        seen, covered, *_ = picture(other, env, bands, shade)
        views.append(View(f"c{number:02d}", other, FRAME, seen, covered))
    spreads = np.stack([spread * full, spread * full])
    light = prepare_capture(env, RELIGHT)
    return EvidenceInputs(color, surface, spreads, views, proxy(), light), painted
