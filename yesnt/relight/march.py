"""Shadow rays marched in view space against the depth buffer: for shots without a proxy, and the paper's single factor.

A depth buffer has no thickness. A ray that passes more than `thickness` behind it is taken to be free: a hand in front
of the chest then shadows what is close to it and does not blacken the body. Source: docs/method.md section 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.compiled import exact_entry, exact_kernel
from yesnt.relight.lens import PINHOLE, LensRecord, distorted, lens_record, pixel_focal
from yesnt.relight.points import Pixels, Surface, has_depth
from yesnt.relight.ranges import over_ranges
from yesnt.relight.shading_frame import Vector

F32 = NDArray[np.float32]

_REACH = 0.6  # of the subject's height: about longer shadows one view knows too little
_SLOPE = 0.02  # of the distance along the ray that the surface may rise to meet it without being an occluder
_PIXELS = 2.0  # footprints of a pixel that a ray must pass behind the buffer: the surface's own slope within a pixel


class DepthScene(NamedTuple):
    """A depth buffer and its camera.

    Attributes:
        z: [H, W] planar depth, metres; infinite where nothing is.
        camera_from_world: [3, 4].
        lens: intrinsics and distortion of the camera.
        reach: length of a march, metres.
        thickness: depth behind the buffer that occludes, metres.
        focal: focal length in pixels along the longer side of a pixel.
    """

    z: F32
    camera_from_world: F32
    lens: LensRecord
    reach: np.float32
    thickness: np.float32
    focal: np.float32


class Rays(NamedTuple):
    """Rays from P points in C directions.

    Attributes:
        origins: [P, 3] world metres.
        normals: [P, 3] unit, world.
        directions: [3, C] unit, world, away from the points.
    """

    origins: F32
    normals: F32
    directions: F32


def depth_scene(surface: Surface, pixels: Pixels, thickness: float) -> DepthScene:
    """Prepares a march.

    Args:
        surface: G-buffer whose z, opacity and camera are read; pixels of opacity up to 0.5 do not occlude.
        pixels: its covered pixels.
        thickness: metres behind the buffer that occlude; 0 estimates them as half the typical width of the matte.
    """
    z = np.asarray(surface.z, dtype=np.float32)
    covered = np.nan_to_num(np.asarray(surface.opacity, dtype=np.float32)) > 0.5
    known = has_depth(z) & covered
    buffer = np.where(known, z, np.inf).astype(np.float32)
    pose = surface.camera.pose(surface.frame)
    inverse = np.concatenate([pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3:]], axis=1).astype(np.float32)
    lens, record = surface.camera.lens(surface.frame), lens_record(surface.camera, surface.frame)
    depth = float(np.median(z[known])) if known.any() else 1.0
    extent = float(np.ptp(np.nonzero(known)[0])) * depth / lens.fy if known.any() else 1.0
    focal = np.float32(pixel_focal(lens))
    thickness = thickness or _half_width(known) * depth / lens.fx
    return DepthScene(buffer, inverse, record, np.float32(_REACH * extent), np.float32(thickness), focal)


def _half_width(known: NDArray[np.bool_]) -> float:
    """Half the median run of covered pixels along rows, pixels: bodies and limbs are about as deep as they are wide."""
    edges = np.diff(np.pad(known.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    runs = np.nonzero(edges == -1)[1] - np.nonzero(edges == 1)[1]
    return 0.5 * float(np.median(runs)) if len(runs) else 1.0


def march(scene: DepthScene, origins: F32, normals: F32, directions: F32, steps: int) -> NDArray[np.bool_]:
    """Whether the depth buffer occludes each direction from each point.

    Args:
        scene: the depth buffer.
        origins: [P, 3] world metres.
        normals: [P, 3] unit, world; directions below their horizon count as not occluded.
        directions: [3, C] unit, world, away from the points.
        steps: samples along each ray; their distance grows, since contacts are near.

    Returns:
        [P, C] True where occluded.
    """
    hidden = np.zeros((len(origins), directions.shape[1]), dtype=np.bool_)
    rays = Rays(*(np.ascontiguousarray(a) for a in (origins, normals, directions)))
    over_ranges(len(hidden), lambda first, last: _march(first, last, scene, rays, steps, hidden))
    return hidden


@exact_entry
def _march(first, last, scene, rays, steps, hidden):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes which directions are occluded from points [first, last) to `hidden` [P, C], which is False."""
    for p in range(first, last):
        origin = Vector(rays.origins[p, 0], rays.origins[p, 1], rays.origins[p, 2])
        for c in range(hidden.shape[1]):
            along = Vector(rays.directions[0, c], rays.directions[1, c], rays.directions[2, c])
            cos_i = rays.normals[p, 0] * along.x + rays.normals[p, 1] * along.y + rays.normals[p, 2] * along.z
            if cos_i > np.float32(0):
                hidden[p, c] = _march_ray(scene, origin, along, steps)


@exact_kernel
def _march_ray(scene, origin, along, steps):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """True if the ray passes behind the depth buffer by less than the thickness."""
    height, width = scene.z.shape
    pose, lens = scene.camera_from_world, scene.lens
    for i in range(1, steps + 1):
        share = np.float32(i) / np.float32(steps)
        distance = scene.reach * share * share
        x, y, z = origin.x + along.x * distance, origin.y + along.y * distance, origin.z + along.z * distance
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth <= np.float32(0):
            return False
        right = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        if lens.model != PINHOLE:
            if right * right + down * down > lens.reach * lens.reach * depth * depth:
                return False
            bent = distorted(right / depth, down / depth, lens)
            right, down = bent.x * depth, bent.y * depth
        column = int(np.floor(lens.fx * right / depth + lens.cx))
        row = int(np.floor(lens.fy * down / depth + lens.cy))
        if column < 0 or row < 0 or column >= width or row >= height:
            return False
        behind = depth - scene.z[row, column]
        margin = np.float32(_SLOPE) * distance + np.float32(_PIXELS) * depth / scene.focal
        if margin < behind < scene.thickness + margin:
            return True
    return False
