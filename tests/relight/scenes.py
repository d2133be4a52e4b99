"""Small G-buffers, maps and meshes, made from formulas."""

import numpy as np

from yesnt.relight import Camera, EnvMap, GBuffer, Surface


def camera(size=(24, 24)):
    """Looks along +Y from (0, -4, 0), Z up; the unit sphere fills most of the frame."""
    height, width = size
    pose = np.array([[1.0, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0], [0, 0, 0, 1]])
    return Camera(width, height, 1.7 * width, 1.7 * width, width / 2, height / 2, {1: pose})


def sphere(size=(24, 24), base=(0.6, 0.4, 0.2), roughness=0.5, metallic=0.0):
    """Unit sphere at the origin, seen by `camera`."""
    cam = camera(size)
    rays, eye = cam.rays(1).astype(np.float64), cam.position(1)
    length = np.linalg.norm(rays, axis=-1)
    along = rays / length[..., None]
    middle = -(along @ eye)
    inside = middle**2 - (eye @ eye - 1)
    hit = inside > 0
    distance = np.where(hit, middle - np.sqrt(np.maximum(inside, 0)), 0)
    normal = np.where(hit[..., None], eye + along * distance[..., None], 0).astype(np.float32)
    z = np.where(hit, distance / length, 1e10).astype(np.float32)
    full = np.ones(size, np.float32)
    colour = np.broadcast_to(np.float32(base), (*size, 3)).copy()
    return GBuffer(colour, roughness * full, metallic * full, normal, z, hit.astype(np.float32)), cam


def surface(gbuffer, cam, frame=1):
    return Surface(gbuffer.normal, gbuffer.z, gbuffer.opacity, gbuffer.roughness, gbuffer.metallic, cam, frame)


def sky(rows=16, seed=3):
    """A map with structure and one bright texel."""
    rng = np.random.default_rng(seed)
    radiance = rng.gamma(0.7, 1.0, (rows, 2 * rows, 3)).astype(np.float32)
    radiance[rows // 4, rows // 2] = 40.0
    return EnvMap.from_array(radiance)


def box_mesh(low, high):
    """Axis-aligned box: 12 triangles, normals outwards."""
    corners = np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)], dtype=np.float32)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, dtype=np.int32)
