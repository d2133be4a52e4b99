"""From G-buffer images to the pixels that are shaded, cleaned once, so that the kernels may assume finite numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.relight.brdf import COS_MIN, alpha_ggx
from yesnt.relight.records import ShadingPoints

F32 = NDArray[np.float32]

FAR = 1e8
"""Planar depth, metres, from which a pixel counts as empty; renderers write 1e10."""

_TRACE = 1 / 512
"""Metallic below the precision of an 8-bit pass is 0, so that noise in a pass does not cost a second lobe."""


_WITHIN = 0.06
"""Growth of alpha_ggx^2 per squared turn of the normal from pixel to pixel.

The variance within a pixel is a twelfth of that (a box), and GGX's alpha^2 is near twice the variance of its slopes,
for each of two axes (Kaplanyan et al. 2016, "Filtering distributions of normals"). Of 0.06, 0.10 and 0.15, measured on
the knot of the capture stage, 0.06 was best."""


def widened(alpha: F32, turn: F32) -> F32:
    """alpha_ggx [...] of a lobe that varies within a pixel, where the normal turns by `turn` [...], rad^2."""
    return np.asarray(np.sqrt(np.square(alpha) + np.float32(_WITHIN) * turn))


@dataclass(frozen=True)
class Pixels:
    """The P shaded pixels of one frame.

    Attributes:
        index: [P] flat index in the image.
        shape: (H, W).
        position: [P, 3] world metres; pixels without a depth lie at the median depth.
        normal: [P, 3] unit, world; one that was zero or not finite faces the camera.
        view: [P, 3] unit, world, towards the camera.
        roughness: [P] 0..1.
        metallic: [P] 0..1.
        turn: [P] squared angle, rad^2, by which the normal turns from pixel to pixel; None: unknown, taken as 0.
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
        """cos_o = n.v [P], clamped as in the kernels."""
        return np.clip((self.normal * self.view).sum(axis=1), COS_MIN, 1.0)

    def taken(self, which: slice | NDArray[np.intp]) -> Pixels:
        """Some of the pixels."""
        turn = None if self.turn is None else self.turn[which]
        return Pixels(
            self.index[which], self.shape, self.position[which], self.normal[which], self.view[which],
            self.roughness[which], self.metallic[which], turn,
        )  # fmt: skip

    def image(self, values: F32) -> F32:
        """Image [H, W] or [H, W, C] of values [P] or [P, C]; 0 elsewhere."""
        flat = np.zeros((self.shape[0] * self.shape[1], *values.shape[1:]), dtype=np.float32)
        flat[self.index] = values
        return flat.reshape(*self.shape, *values.shape[1:])

    def lobes(self, part: slice, brdf: str, diffuse: str = "lambert") -> ShadingPoints:
        """The record that the kernels read, of a range of pixels.

        Args:
            part: the range.
            brdf: "default": dielectric and metallic lobe where they are needed; "paper": one lobe, as metallic.
            diffuse: "lambert" or "disney".
        """
        metallic, alpha = self.metallic[part], alpha_ggx(self.roughness[part])
        default = brdf == "default"
        if default and self.turn is not None:
            alpha = widened(alpha, self.turn[part])
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
    """G-buffer images of one frame, without colour.

    Attributes:
        normal: [H, W, 3] world; shorter than 1 where a renderer averaged directions.
        z: [H, W] planar depth, metres; 0, NaN or 1e10 where nothing is.
        opacity: [H, W] coverage, 0..1.
        roughness: [H, W] Disney's, 0..1.
        metallic: [H, W] 0..1.
        camera: pinhole camera of the size of the images.
        frame: frame number of the camera's pose; None: the first.
    """

    normal: NDArray[np.floating]
    z: NDArray[np.floating]
    opacity: NDArray[np.floating]
    roughness: NDArray[np.floating]
    metallic: NDArray[np.floating]
    camera: Camera
    frame: int | None = None


def has_depth(z: NDArray[np.floating]) -> NDArray[np.bool_]:
    """True where a planar depth [...] is finite, above 0 and below FAR."""
    return np.isfinite(z) & (z > 0) & (z < FAR)


def gather_pixels(surface: Surface) -> Pixels:
    """The pixels of positive coverage, cleaned: no NaN, unit normals, materials in [0, 1]."""
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
    """`Pixels.turn` [P]: squared turn of the normal to the next pixel, summed over both image axes, at most 1.

    Along each axis the side with the smaller turn is taken, so that an edge does not count as curvature.
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
    """Unit vectors [P, 3]; `otherwise` where a vector has no length or is not finite."""
    clean = np.clip(np.nan_to_num(vector, nan=0.0, posinf=0.0, neginf=0.0), -1e6, 1e6)
    length = np.linalg.norm(clean, axis=1, keepdims=True)
    return np.where(length > 1e-6, clean / np.maximum(length, 1e-6), otherwise).astype(np.float32)


def _unit_range(values: F32, missing: float) -> F32:
    """Values clipped to [0, 1]; `missing` where they are NaN."""
    return np.clip(np.nan_to_num(values, nan=missing), 0, 1).astype(np.float32)
