"""What each camera saw of the points of a frame: projection, visibility against the proxy, bilinear samples."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.depth import SLOPE, planar_depth, slope
from yesnt.decompose.evidence.records import Observations, View
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight.proxy import ProxyScene

F32 = NDArray[np.float32]
Float = NDArray[np.floating]
Bool = NDArray[np.bool_]

_SILHOUETTE_STEP = 8
"""Pixels between the rays that compare the proxy's silhouette with a matte."""


@dataclass(frozen=True)
class SeenView:
    """A view with what it shows of the proxy.

    Attributes:
        view: the view.
        depth: [H, W] planar depth of the proxy, metres; 0 where there is none or nothing is covered.
        usable: [H, W] covered and not damaged.
        radiance: [H, W, 3] of the view, 0 where it is not usable.
        deviation: [H, W, 3] standard deviation within 3 x 3 pixels.
    """

    view: View
    depth: F32
    usable: Bool
    radiance: F32
    deviation: F32


@dataclass(frozen=True)
class Sample:
    """What one camera saw of P points.

    Attributes:
        radiance: [P, 3] scene-linear; 0 where not valid.
        deviation: [P, 3] within 3 x 3 pixels.
        valid: [P] whether the camera sees the point.
        towards: [P, 3] unit direction from the point to the camera.
        footprint: [P] metres that a pixel covers at the point.
    """

    radiance: F32
    deviation: F32
    valid: Bool
    towards: F32
    footprint: F32

    def divided(self, gain: Float) -> Sample:
        """The same with the radiance of each channel divided by its gain [3]."""
        factor = (1 / gain).astype(np.float32)
        return replace(self, radiance=self.radiance * factor, deviation=self.deviation * factor)

    def taken(self, which: NDArray[np.intp]) -> Sample:
        """Some of the points."""
        return Sample(*(getattr(self, one.name)[which] for one in fields(self)))


def prepare_view(view: View, proxy: ProxyScene, settings: EvidenceSettings) -> SeenView:
    """Finds where a camera sees the proxy, and how its picture varies."""
    finite = np.isfinite(view.radiance).all(axis=-1) & np.isfinite(view.matte)
    usable = finite & (view.matte > settings.covered)
    radiance = np.where(finite[..., None], np.clip(view.radiance, 0, None), 0).astype(np.float32)
    return SeenView(view, _proxy_depth(view, proxy, usable), usable, radiance, local_deviation(radiance))


def local_deviation(image: F32) -> F32:
    """Standard deviation [H, W, 3] of an image within 3 x 3 pixels."""
    mean = cv2.blur(image, (3, 3))
    return np.sqrt(np.maximum(cv2.blur(image * image, (3, 3)) - mean * mean, 0)).astype(np.float32)


def _proxy_depth(view: View, proxy: ProxyScene, wanted: Bool) -> F32:
    """Planar depth [H, W] of the proxy at the wanted pixels; 0 elsewhere and where it is missed."""
    rays = view.camera.rays(view.pose)[wanted]
    depth = np.zeros(wanted.shape, dtype=np.float32)
    if len(rays):
        depth[wanted] = planar_depth(proxy, view.camera.position(view.pose), rays)
    return depth


def silhouette_overlap(view: View, proxy: ProxyScene) -> tuple[float, float]:
    """How far the proxy's silhouette agrees with a matte: shared over joint area, and the proxy's share of the picture.

    Measured at every eighth pixel of every eighth row. A wrong pose or another subject's matte gives a small overlap.
    """
    step = slice(_SILHOUETTE_STEP // 2, None, _SILHOUETTE_STEP)
    rays = view.camera.rays(view.pose)[step, step]
    eye = view.camera.position(view.pose)
    shown = (planar_depth(proxy, eye, rays.reshape(-1, 3)) > 0).reshape(rays.shape[:2])
    covered = np.nan_to_num(view.matte[step, step]) > 0.5
    joint = float((shown | covered).sum())
    return (float((shown & covered).sum()) / joint if joint else 0.0), float(shown.mean())


def sample_view(seen: SeenView, points: Float, normals: Float, size: float, settings: EvidenceSettings) -> Sample:
    """What a camera saw of points.

    A point is seen where all four pixels around it are usable and show the proxy at the point's depth, and the surface
    faces the camera. Four neighbours keep observations away from silhouettes, where pose errors hurt most.

    Args:
        seen: the view.
        points: [P, 3] world metres.
        normals: [P, 3] unit, world.
        size: largest extent of the proxy, metres.
        settings: of the evidence.
    """
    camera, pose = seen.view.camera, seen.view.pose
    towards = camera.position(pose) - points
    distance = np.linalg.norm(towards, axis=1, keepdims=True)
    towards = towards / np.maximum(distance, 1e-9)
    x, y, z = np.moveaxis(camera.project(points, pose), -1, 0)
    cosine = (normals * towards).sum(axis=1)
    footprint = z / camera.lens(pose).fx
    inside = _inside(x, y, z, seen.depth.shape)
    column, row = (np.where(inside, a - 0.5, 0.0) for a in (x, y))
    corner = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    apart = settings.depth * size + SLOPE * slope(cosine) * footprint
    valid = inside & (cosine > settings.cosine)
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        at = corner[1] + down, corner[0] + across
        valid &= seen.usable[at] & (np.abs(seen.depth[at] - z) < apart)
    radiance, deviation = (_bilinear(plane, column, row) for plane in (seen.radiance, seen.deviation))
    return Sample(
        np.where(valid[:, None], radiance, 0).astype(np.float32), deviation, valid,
        towards.astype(np.float32), footprint.astype(np.float32),
    )  # fmt: skip


def _inside(x: Float, y: Float, z: Float, shape: tuple[int, ...]) -> Bool:
    """Whether all four pixels around a point lie in the picture; False where x or y is NaN."""
    with np.errstate(invalid="ignore"):
        return (z > 0) & (x >= 0.5) & (y >= 0.5) & (x < shape[1] - 0.5) & (y < shape[0] - 0.5)


def _bilinear(image: F32, column: Float, row: Float) -> F32:
    """Values [P, 3] between pixels; columns and rows count from pixel centres."""
    i, j = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    fy, fx = (row - i)[:, None], (column - j)[:, None]
    upper = image[i, j] * (1 - fx) + image[i, j + 1] * fx
    lower = image[i + 1, j] * (1 - fx) + image[i + 1, j + 1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, dtype=np.float32)


def observations(
    samples: list[Sample], floor: float, settings: EvidenceSettings, occluded: F32 | None = None
) -> Observations:
    """Stacks the samples of V views, with the standard deviation of each.

    sigma^2 = (relative y)^2 + floor^2 + (edge times the local deviation)^2 + (indirect times the occluded share y)^2.

    Args:
        samples: of V views.
        floor: absolute part of sigma, radiance.
        settings: of the evidence.
        occluded: [P, V] of mirrored.occluded_share; None: 0.
    """
    radiance = np.stack([one.radiance for one in samples], axis=1)
    deviation = np.stack([one.deviation for one in samples], axis=1)
    share = 0 if occluded is None else (settings.indirect * occluded[..., None]) ** 2
    variance = (settings.relative**2 + share) * radiance**2 + floor**2 + (settings.edge * deviation) ** 2
    sigma = np.sqrt(variance)
    return Observations(radiance, sigma.astype(np.float32), np.stack([one.valid for one in samples], axis=1))
