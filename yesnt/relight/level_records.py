"""Records of the sums over several levels of roughness (relight/level_sums.py). P points, C clusters, R levels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.albedo import albedo_tables, multiple_scattering

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
Float = NDArray[np.float64]


class LevelPoints(NamedTuple):
    """P points as one camera sees them.

    Attributes:
        normal: [P, 3] unit, world.
        viewer: [P, 3] unit, world, towards the camera.
        alpha: [P, R] alpha_ggx of every level.
        hits: [P, C] triangle towards each light cluster, OPEN where there is none.
        own: [P] cluster that the mirrored view points to, -1: none.
        mirrored: [P] triangle along the mirrored view, which sharp levels read for that cluster.
        sharp: number of levels, the first ones, that do.
    """

    normal: F32
    viewer: F32
    alpha: F32
    hits: I32
    own: I32
    mirrored: I32
    sharp: int


class LevelTerms(NamedTuple):
    """Exact albedos of R levels, evenly over sqrt(cos_o) in [0, 1], and energy terms (relight/albedo.py).

    Attributes:
        white: [R, M] directional albedo with F = 1.
        dielectric: [R, M] with the Fresnel reflectance of IOR 1.5.
        schlick: [R, M] with F = (1 - cos_d)^5.
        scattering: [R] Fms of a dielectric.
        average: [R] mean albedo.
    """

    white: Float
    dielectric: Float
    schlick: Float
    scattering: Float
    average: Float

    @classmethod
    def of(cls, levels: NDArray[np.floating]) -> LevelTerms:
        """Of roughness levels [R] in [0, 1]."""
        tables = albedo_tables()
        cos_o = np.linspace(0, 1, tables.white.shape[1]) ** 2
        grid = np.broadcast_arrays(np.asarray(levels, np.float64)[:, None], cos_o[None])
        white, dielectric, schlick = (
            tables.lookup(table, *grid).astype(np.float64)
            for table in (tables.white, tables.dielectric, tables.schlick)
        )
        average = np.interp(levels, np.linspace(0, 1, len(tables.average)), tables.average)
        scattering = multiple_scattering(np.asarray(tables.fresnel_average), average)
        return cls(white, dielectric, schlick, np.asarray(scattering, np.float64), average)


class LevelSums(NamedTuple):
    """Responses of P points at R levels; the fields are those of evidence's `Responses`, towards one camera.

    Attributes:
        diffuse: [P, R, 3].
        dielectric: [P, R, 3].
        metal_f0: [P, R, 3].
        metal_f90: [P, R, 3].
        missing: [P, R].
    """

    diffuse: F32
    dielectric: F32
    metal_f0: F32
    metal_f90: F32
    missing: F32
