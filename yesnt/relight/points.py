"""From images to the pixels that are shaded, cleaned once so that kernels may assume finite numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.relight.brdf import COS_MIN, alpha_ggx
from yesnt.relight.records import ShadingPoints

F32 = NDArray[np.float32]

FAR = 1e8
"""Planar depth, metres, from which a pixel counts as a miss; renderers write 1e10."""

_TRACE = 1 / 512
"""Less metal than an 8-bit pass can say is none, so that noise in a pass does not cost the second lobe."""


_WITHIN = 0.06
"""Growth of alpha^2 by the squared turn of the normal from pixel to pixel.

Within a pixel it varies by a twelfth of that (a box), and GGX's alpha^2 is near twice the variance of its slopes, for
each of two axes (Kaplanyan et al. 2016, "Filtering distributions of normals"). Of 0.06, 0.10 and 0.15, tried on the
stage's knot, the first was best."""


@dataclass(frozen=True)
class Pixels:
    """Shaded pixels of one frame.

    Attributes:
        index: [P] flat position in the image.
        shape: (H, W).
        position: [P, 3] world metres; pixels without a depth lie at the median depth.
        normal: [P, 3] unit, world; a zero-length or non-finite one faces the camera.
        view: [P, 3] unit, world, towards the camera.
        roughness: [P] 0..1.
        metallic: [P] 0..1.
        turn: [P] squared angle, rad^2, that the normal turns by from pixel to pixel; None: not known, taken as 0.
    """

    index: NDArray[np.int64]
    shape: tuple[int, int]
    position: F32
    normal: F32
    view: F32
    roughness: F32
    metallic: F32
    turn: F32 | None = None

    @property
    def cos_o(self) -> F32:
        """n.v as the kernels clamp it, [P]."""
        return np.clip((self.normal * self.view).sum(axis=1), COS_MIN, 1.0)

    def image(self, values: F32) -> F32:
        """Scatters [P] or [P, C] into a zero image [H, W] or [H, W, C]."""
        flat = np.zeros((self.shape[0] * self.shape[1], *values.shape[1:]), dtype=np.float32)
        flat[self.index] = values
        return flat.reshape(*self.shape, *values.shape[1:])

    def lobes(self, part: slice, brdf: str, diffuse: str = "lambert") -> ShadingPoints:
        """Kernel input of a range of pixels."""
        metallic, alpha = self.metallic[part], alpha_ggx(self.roughness[part])
        default = brdf == "default"
        if default and self.turn is not None:
            alpha = np.sqrt(np.square(alpha) + np.float32(_WITHIN) * self.turn[part])
        return ShadingPoints(
            np.ascontiguousarray(self.normal[part].T),
            np.ascontiguousarray(self.view[part].T),
            alpha.astype(np.float32),
            (metallic < 1).astype(np.uint8) if default else np.zeros(len(metallic), dtype=np.uint8),
            (metallic > 0).astype(np.uint8) if default else np.ones(len(metallic), dtype=np.uint8),
            diffuse == "disney",
        )


@dataclass(frozen=True)
class Surface:
    """G-buffer images without colour.

    Attributes:
        normal: [H, W, 3] world.
        z: [H, W] planar metres; 0, NaN or 1e10 where nothing is.
        opacity: [H, W] coverage.
        roughness: [H, W] Disney r.
        metallic: [H, W].
        camera: pinhole camera of the image's size.
        frame: which of the camera's poses.
    """

    normal: NDArray[np.floating]
    z: NDArray[np.floating]
    opacity: NDArray[np.floating]
    roughness: NDArray[np.floating]
    metallic: NDArray[np.floating]
    camera: Camera
    frame: int | None = None


def has_depth(z: NDArray[np.floating]) -> NDArray[np.bool_]:
    """True where a planar depth is one."""
    return np.isfinite(z) & (z > 0) & (z < FAR)


def gather_pixels(surface: Surface) -> Pixels:
    """Takes the pixels of positive coverage out of the images."""
    opacity = np.nan_to_num(np.asarray(surface.opacity, dtype=np.float32), nan=0.0)
    index = np.flatnonzero(opacity > 0)
    take = [np.asarray(a, dtype=np.float32) for a in (surface.z, surface.roughness, surface.metallic)]
    z, roughness, metallic = (a.reshape(-1)[index] for a in take)
    rays = surface.camera.rays(surface.frame).reshape(-1, 3)[index]
    known = has_depth(z)
    depth = np.where(known, z, np.median(z[known]) if known.any() else np.float32(1))
    position = surface.camera.position(surface.frame).astype(np.float32) + rays * depth[:, None]
    view = -rays / np.linalg.norm(rays, axis=1, keepdims=True)
    normal = _unit_or(np.asarray(surface.normal, dtype=np.float32).reshape(-1, 3)[index], view)
    metallic = _unit_range(metallic, 0.0)
    metallic = np.where(metallic < _TRACE, 0, np.where(metallic > 1 - _TRACE, 1, metallic)).astype(np.float32)
    turn = _turns(normal, index, opacity.shape)
    return Pixels(index, opacity.shape, position, normal, view, _unit_range(roughness, 1.0), metallic, turn)


def _turns(normal: F32, index: NDArray[np.int64], shape: tuple[int, int]) -> F32:
    """Squared angle that the normal turns by from pixel to pixel [P], both axes added.

    Along each axis the smaller of both sides' is taken, so that an edge is no curvature; at most 1.
    """
    image = np.full((shape[0] + 2, shape[1] + 2, 3), np.inf, dtype=np.float32)
    row, column = index // shape[1] + 1, index % shape[1] + 1
    image[row, column] = normal
    turn = np.zeros(len(index), dtype=np.float32)
    for down, across in ((1, 0), (0, 1)):
        sides = [image[row + s * down, column + s * across] for s in (-1, 1)]
        apart = np.minimum(*(np.square(normal - side).sum(axis=1) for side in sides))
        turn += np.where(np.isfinite(apart), apart, 0)
    return np.minimum(turn, 1)


def _unit_or(vector: F32, otherwise: F32) -> F32:
    clean = np.clip(np.nan_to_num(vector, nan=0.0, posinf=0.0, neginf=0.0), -1e6, 1e6)
    length = np.linalg.norm(clean, axis=1, keepdims=True)
    return np.where(length > 1e-6, clean / np.maximum(length, 1e-6), otherwise).astype(np.float32)


def _unit_range(values: F32, missing: float) -> F32:
    return np.clip(np.nan_to_num(values, nan=missing), 0, 1).astype(np.float32)
