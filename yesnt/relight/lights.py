"""An env map made ready once per process: weighted directions, clusters for visibility, cones for culling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.color import luminance
from yesnt.relight.envmap import EnvMap, cell_moments
from yesnt.relight.tree import Box, grow, importance

F32 = NDArray[np.float32]

BLOCK = 64
"""Texels that share one culling cone: a multiple of every vector width, small enough to cull."""

COARSE = 64
"""Clusters that light the proxy's triangles: what bounces is a small, smooth part of the result."""

GRID_ROWS = 128
"""Rows of the finest grid that texels are cut from: 1.4 degrees, finer than one visibility can tell."""


@dataclass(frozen=True)
class Clusters:
    """Parts of a map that are told apart by one direction each.

    Attributes:
        direction: [3, C] unit, world; luminance centroid.
        energy: [3, C] radiance times solid angle.
        solid_angle: [C] sr.
        reach: [C] sine of the angular radius: how far below a horizon the centre may lie while a part is above.
    """

    direction: F32
    energy: F32
    solid_angle: F32
    reach: F32


@dataclass(frozen=True)
class PreparedLight:
    """Structure of arrays, texels sorted by cluster.

    Attributes:
        direction: [3, T] unit, world; the luminance centroid of each texel.
        energy: [3, T] radiance times solid angle, W/m^2 per channel.
        solid_angle: [T] sr.
        spread: [T] angular variance of each texel's light, rad^2.
        cluster_of: [T] cluster of each texel, ascending.
        clusters: directions that each have one visibility.
        coarse: fewer of them, for the light that the proxy's triangles receive.
        cone: [4, ceil(T / BLOCK)] axis and sine of the half angle of each block of texels (2: never culled).
        env: the map itself.
    """

    direction: F32
    energy: F32
    solid_angle: F32
    spread: F32
    cluster_of: NDArray[np.int32]
    clusters: Clusters
    coarse: Clusters
    cone: F32
    env: EnvMap


def prepare_light(env: EnvMap, texels: int, clusters: int, rows: int = GRID_ROWS, least: int = 1) -> PreparedLight:
    """Cuts a map into `clusters` and these into `texels`, on a grid of at most `rows` x 2 `rows` cells.

    A map of no more rows is cut along its own texels; one of fewer than `least` rows is first subdivided. With enough
    `texels` every cell is one. The sum of `energy` equals the map's to rounding at any setting. Pure: the
    same map gives the same bits.
    """
    size = tuple(
        min(most, max(have, k * least))
        for k, most, have in zip((1, 2), (rows, 2 * rows), env.radiance.shape[:2], strict=True)
    )
    moments = cell_moments(env, size)
    lit = _direction(moments)
    weights = importance(np.asarray(luminance(moments[..., :3]), dtype=np.float64), lit, moments[..., 6])
    boxes = grow(weights, clusters, texels)
    sizes = [len(group) for group in boxes]
    sums = _box_sums(moments, [box for group in boxes for box in group])
    starts = np.cumsum([0, *sizes[:-1]])
    world = _direction(sums) @ env.world_from_map.T
    return PreparedLight(
        direction=_columns(world),
        energy=_columns(sums[:, :3]),
        solid_angle=sums[:, 6].astype(np.float32),
        spread=_spread(sums, np.array([(b - a) * (d - c) for group in boxes for a, b, c, d in group])).astype(
            np.float32
        ),
        cluster_of=np.repeat(np.arange(len(sizes)), sizes).astype(np.int32),
        clusters=_clusters(np.add.reduceat(sums, starts, axis=0), env),
        coarse=_clusters(_box_sums(moments, _outer(weights, min(clusters, COARSE))), env),
        cone=_cones(world),
        env=env,
    )


def _outer(weights: NDArray[np.float64], count: int) -> list[Box]:
    return [group[0] for group in grow(weights, count, 1)]


def _clusters(sums: NDArray[np.float64], env: EnvMap) -> Clusters:
    solid = sums[:, 6]
    reach = np.minimum(1.5 * np.sqrt(solid / np.pi), 1.0)  # 1.5: boxes up to about 2:1 fit inside
    direction = _columns(_direction(sums) @ env.world_from_map.T)
    return Clusters(direction, _columns(sums[:, :3]), solid.astype(np.float32), reach.astype(np.float32))


def uniform_light(radiance: float = 1.0) -> EnvMap:
    """The capture light that is assumed when none is given: the same radiance from everywhere."""
    return EnvMap.from_array(np.full((16, 32, 3), radiance, dtype=np.float32))


def _box_sums(moments: NDArray[np.float64], boxes: list[Box]) -> NDArray[np.float64]:
    """Sums of moments over boxes [T, k]; summed directly, since a summed-area table would cancel beside a sun."""
    return np.stack([moments[a:b, c:d].sum(axis=(0, 1)) for a, b, c, d in boxes])


def _direction(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit direction of light [..., 3]: the luminance centroid, or that of the solid angle where there is no light."""
    light, area = moments[..., 3:6], moments[..., 7:10]
    chosen = np.where(np.linalg.norm(light, axis=-1, keepdims=True) > 1e-30, light, area)
    length = np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.where(length > 1e-30, chosen / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))


def _spread(sums: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Angular variance of a texel's light: 2 (1 - |mean direction|), plus that of a square cell of its size."""
    light = luminance(sums[:, :3])
    weight, moment = np.where(light > 1e-30, light, sums[:, 6]), sums[:, 3:6]
    moment = np.where(light[:, None] > 1e-30, moment, sums[:, 7:10])
    return 2 * np.clip(1 - np.linalg.norm(moment, axis=1) / weight, 0, 1) + sums[:, 6] / cells / 6


def _columns(values: NDArray[np.float64]) -> F32:
    return np.ascontiguousarray(values.T, dtype=np.float32)


def _cones(direction: NDArray[np.float64]) -> F32:
    count = -(-len(direction) // BLOCK)
    cones = np.empty((4, count), dtype=np.float32)
    for i in range(count):
        part = direction[i * BLOCK : (i + 1) * BLOCK]
        axis = part.sum(axis=0) / max(float(np.linalg.norm(part.sum(axis=0))), 1e-30)
        cosine = float((part @ axis).min())
        cones[:3, i] = axis
        cones[3, i] = np.sqrt(1 - cosine**2) + 1e-5 if cosine > 0 else 2.0
    return cones
