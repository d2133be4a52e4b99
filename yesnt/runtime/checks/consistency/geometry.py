"""Normals against the camera and against the slope of depth.

On a surface with normal n (camera axes) z (n . r) is constant to first order, r = (x, y, 1). The logarithm of planar
depth therefore changes by -(n_x dx + n_y dy) / (n . r), whatever its unit. Distance along the ray is z |r| and inverse
depth is 1 / z: both change in another way, which tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.shot import GBufferInput
from yesnt.runtime.checks.consistency.sample import LEAST, Sample

F64 = NDArray[np.float64]

_GRAZING = 0.25  # least cosine to the ray: at silhouettes the slope within a pixel is not the normal's
_EDGE = 0.1  # largest change of log z over two pixels: more is an edge between surfaces


_OUTLIER = 4.5  # of the median misfit: three standard deviations


@dataclass(frozen=True)
class Agreement:
    """How normals fit the camera and depth, shares in [0, 1].

    Attributes:
        facing: of normals with a length that face the camera.
        along: of slopes of depth that have the sign which the normals predict; NaN where too few are steep.
        misfit: median difference of a slope from the prediction, over the median slope; 0: they are equal.
    """

    facing: float
    along: float
    misfit: float = 0.0

    @property
    def share(self) -> float:
        """The lower of both shares."""
        return float(np.nanmin([self.facing, self.along, 1.0]))


def agreement(sample: Sample, normal: F64) -> Agreement:
    """Compares normals [P, 3], in camera axes, with the rays and with the slopes of depth."""
    facing, _ = cosines(sample, normal)
    predicted, good = predicted_slopes(sample, normal)
    steep = good & (np.abs(predicted) > np.median(np.abs(predicted[good]))) if good.any() else good
    along = float((predicted * sample.slopes > 0)[steep].mean()) if steep.sum() > LEAST else float("nan")
    off, size = (np.abs(values[good]) for values in (predicted - sample.slopes, sample.slopes))
    misfit = float(np.median(off) / max(np.median(size), 1e-12)) if good.any() else 0.0
    return Agreement(float((facing > 0).mean()) if len(facing) else float("nan"), along, misfit)


def cosines(sample: Sample, normal: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Cosine between each normal and the direction to the camera, of those with a length; and which have one."""
    length = np.linalg.norm(normal, axis=1)
    known = length > 0.1
    toward = -(normal * sample.ray).sum(axis=1) / np.linalg.norm(sample.ray, axis=1)
    return toward[known] / length[known], known


def predicted_slopes(sample: Sample, normal: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Change of log z that normals predict along each step [S], and where it can be compared."""
    pixel = sample.step_pixel
    n, r = normal[pixel], sample.ray[pixel]
    along = (n * r).sum(axis=1)
    length = np.linalg.norm(n, axis=1) * np.linalg.norm(r, axis=1)
    good = (np.abs(along) > _GRAZING * length) & (length > 0.1) & (np.abs(sample.slopes) < _EDGE)
    predicted = -(n[:, :2] * sample.steps).sum(axis=1) / np.where(good, along, 1)
    return predicted, good & (np.abs(predicted) < _EDGE)


def steepness(sample: Sample) -> float:
    """How many times as much depth changes as the normals say: 1 where z is planar depth from 0; NaN: unknown.

    Units do not change it; an offset (depth from 0 to 1 between two planes) and a wrong focal length do. The median of
    the steeper half of the slopes.
    """
    predicted, good = predicted_slopes(sample, sample.normal)
    if good.sum() <= 2 * LEAST:
        return float("nan")
    steep = good & (np.abs(predicted) > np.median(np.abs(predicted[good])))
    return float(np.median(sample.slopes[steep] / predicted[steep]))


def ray_share(sample: Sample) -> tuple[float, float]:
    """How much depth looks like distance along the ray.

    Returns:
        Share of distance along the ray in the slopes (0: planar depth, 1: distance along the ray; -1: planar depth that
        the job takes for distance); and how much smaller the median misfit becomes with it, at least 1. Noisy normals
        and narrow lenses give any share, and hardly a smaller misfit.
    """
    predicted, good = predicted_slopes(sample, sample.normal)
    r = sample.ray[sample.step_pixel]
    bend = (r[:, :2] * sample.steps).sum(axis=1) / (r * r).sum(axis=1)
    rest = sample.slopes - predicted
    kept, share = good, 0.0
    for _ in range(4):
        if kept.sum() <= LEAST:
            return float("nan"), 1.0
        share = float((bend[kept] * rest[kept]).sum() / max((bend[kept] ** 2).sum(), 1e-30))
        off = np.abs(rest - share * bend)
        kept = good & (off < _OUTLIER * np.median(off[kept]) + 1e-12)
    before, after = (float(np.median(np.abs(values[good]))) for values in (rest, off))
    return share, max(before / max(after, 1e-12), 1.0)


def hypotheses(sample: Sample, spec: GBufferInput) -> dict[str, F64]:
    """Normals [P, 3] in camera axes as they would be if the job, or camera.json, said something else; by what it said.

    Args:
        sample: with normals as the job says.
        spec: the G-buffer's section of the job, by which they were read.
    """
    rotation, opengl = sample.pose[:3, :3], np.array([1.0, -1.0, -1.0])
    stored = _stored(sample, spec)
    ranges = {"signed": stored, "unsigned": 2 * stored - 1}
    found = {"they were flipped: they point into the surface": -sample.normal}
    if spec.normal_space.startswith("world"):
        found['camera.json said `"axes": "opengl"` (the camera looks along its -z)'] = sample.normal * opengl
    for name, values in ranges.items():
        spaces = {
            "world": values @ rotation,
            "world_y_up": values[:, [0, 2, 1]] * [1.0, -1.0, 1.0] @ rotation,
            "camera": values,
            "camera_opengl": values * opengl,
        }
        for space, normal in spaces.items():
            changes = {"normal_range": name, "normal_space": space}
            said = [f"`{key}: {value}`" for key, value in changes.items() if value != getattr(spec, key)]
            if said:
                found[f"the job said {' and '.join(said)}"] = normal
    return found


def _stored(sample: Sample, spec: GBufferInput) -> F64:
    """Normals [P, 3] as the file has them."""
    world = sample.world_normal
    stored = {
        "world": world,
        "world_y_up": world[:, [0, 2, 1]] * [1.0, 1.0, -1.0],
        "camera": sample.normal,
        "camera_opengl": sample.normal * [1.0, -1.0, -1.0],
    }[spec.normal_space]
    return (stored + 1) / 2 if spec.normal_range == "unsigned" else stored
