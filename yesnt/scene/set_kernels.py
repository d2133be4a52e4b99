"""Compiled sums over the rays of the set's pixels; `set_rays.totals` with `SetBrdf.towards` is the NumPy reference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.brdf import COS_MIN, IOR
from yesnt.relight.compiled import exact_entry, exact_kernel

F32 = NDArray[np.float32]


class SampleHits(NamedTuple):
    """R rays from pixels of the set towards samples of the light, which something occludes.

    Attributes:
        row: [R] of the sums that the ray adds to.
        pixel: [R] number of the pixel among those of the BRDF.
        sample: [R] of the light.
        subject: [R] whether the ray meets the subject.
        beside: [R] whether it would meet the set without the subject.
        from_subject: [R, 3] radiance that the subject sends back.
        from_set: [R, 3] radiance of the set.
    """

    row: NDArray[np.int64]
    pixel: NDArray[np.int64]
    sample: NDArray[np.int64]
    subject: NDArray[np.bool_]
    beside: NDArray[np.bool_]
    from_subject: F32
    from_set: F32


class Shape(NamedTuple):
    """The BRDF towards one direction, without what depends on the colour.

    Attributes:
        diffuse: factor of the diffuse BRDF, cos_i included.
        lobe: D V cos_i.
        dielectric: Fresnel reflectance of IOR 1.5.
        schlick: Schlick's weight.
    """

    diffuse: float
    lobe: float
    dielectric: float
    schlick: float


@exact_entry
def sum_samples(hits, brdf, samples, sharp, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Adds what rays change to `out` [n, 9] float64, which is 0: by the set itself, taken and added by the subject.

    Args:
        hits: SampleHits.
        brdf: SetBrdf.
        samples: direction [3, S], energy [3, S] and solid angle [S] of the light.
        sharp: whether the specular lobe is left out.
        out: sums by row; R, G, B of each of the three.
    """
    direction, energy, solid_angle = samples
    for r in range(len(hits.row)):
        row, p, s = hits.row[r], hits.pixel[r], hits.sample[r]
        shape = _towards(p, direction[0, s], direction[1, s], direction[2, s], brdf)
        for k in range(3):
            weight = brdf.diffuse[p, k] * shape.diffuse
            if not sharp:
                layer = brdf.dielectric[p] * shape.dielectric
                metal = brdf.f0[p, k] * (1 - shape.schlick) + brdf.f90[p, k] * shape.schlick
                weight += shape.lobe * (layer + metal)
            before, weight = energy[k, s] * weight, solid_angle[s] * weight
            own = weight * hits.from_set[r, k]
            if hits.beside[r]:
                out[row, k] += own - before
            if hits.subject[r]:
                out[row, 3 + k] += own if hits.beside[r] else before
            out[row, 6 + k] += weight * hits.from_subject[r, k]


@exact_kernel
def _towards(p, x, y, z, brdf):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Shape of the BRDF of pixel p in the unit direction (x, y, z)."""
    nx, ny, nz = np.float64(brdf.normal[p, 0]), np.float64(brdf.normal[p, 1]), np.float64(brdf.normal[p, 2])
    vx, vy, vz = np.float64(brdf.outgoing[p, 0]), np.float64(brdf.outgoing[p, 1]), np.float64(brdf.outgoing[p, 2])
    cos_i = max(nx * x + ny * y + nz * z, 0.0)
    cos_o = min(max(nx * vx + ny * vy + nz * vz, COS_MIN), 1.0)
    hx, hy, hz = x + vx, y + vy, z + vz
    length = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-30)
    cos_h, cos_d = (nx * hx + ny * hy + nz * hz) / length, (vx * hx + vy * hy + vz * hz) / length
    a2 = brdf.alpha * brdf.alpha
    falls = cos_h * cos_h * (a2 - 1) + 1
    masked = cos_o * math.sqrt(cos_i * cos_i * (1 - a2) + a2) + cos_i * math.sqrt(cos_o * cos_o * (1 - a2) + a2)
    lobe = a2 / (math.pi * falls * falls) * 0.5 / max(masked, 1e-30) * cos_i
    diffuse = cos_i
    if brdf.burley >= 0:
        grazing = 2 * brdf.burley * cos_d * cos_d - 0.5
        diffuse *= (1 + grazing * (1 - cos_i) ** 5) * (1 + grazing * (1 - cos_o) ** 5)
    c = min(max(cos_d, 0.0), 1.0)
    g = math.sqrt(IOR * IOR - 1 + c * c)
    ratio = (c * (g + c) - 1) / (c * (g - c) + 1)
    dielectric = 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ratio * ratio)
    return Shape(diffuse, lobe, dielectric, (1 - c) ** 5)
