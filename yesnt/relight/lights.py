"""An env map made ready once per process: weighted directions, clusters for visibility, cones for culling."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

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
    """Structure of arrays: T texels sorted by cluster, then the F cells of the grid that they were cut from, too.

    A lobe is summed over the texels, except that a sharp lobe takes the cells of the clusters that it points at. F is 0
    where every cell is a texel.

    Attributes:
        direction: [3, T + F] unit, world; the luminance centroid of each texel.
        energy: [3, T + F] radiance times solid angle, W/m^2 per channel.
        solid_angle: [T + F] sr.
        spread: [T + F] angular variance of each texel's light, rad^2.
        cluster_of: [T + F] cluster of each texel.
        coarse_start: [C + 1] first texel of each cluster; the last entry is T.
        fine_start: [C + 1] first cell of each cluster, from T on; equal to `coarse_start` where F is 0.
        clusters: directions that each have one visibility.
        coarse: fewer of them, for the light that the proxy's triangles receive.
        cone: [4, ceil(T / BLOCK)] axis and sine of the half angle of each block of texels (2: never culled).
        cluster_cone: [4, C] the same of each cluster.
        env: the map itself.
    """

    direction: F32
    energy: F32
    solid_angle: F32
    spread: F32
    cluster_of: NDArray[np.int32]
    coarse_start: NDArray[np.int32]
    fine_start: NDArray[np.int32]
    clusters: Clusters
    coarse: Clusters
    cone: F32
    cluster_cone: F32
    env: EnvMap


def prepare_light(env: EnvMap, texels: int, clusters: int, rows: int = GRID_ROWS, least: int = 1) -> PreparedLight:
    """Cuts a map into `clusters` and these into `texels`, on a grid of at most `rows` x 2 `rows` cells.

    A map of no more rows is cut along its own texels; one of fewer than `least` rows is first subdivided. With enough
    `texels` every cell is one. The sum of `energy` equals the map's to rounding at any setting. Pure: the same map
    gives the same bits.
    """
    height, width = env.radiance.shape[:2]
    moments = cell_moments(env, (min(rows, max(height, least)), min(2 * rows, max(width, 2 * least))))
    light = np.asarray(luminance(moments[..., :3]), dtype=np.float64)
    weights = importance(light, _direction(moments), moments[..., 6])
    coarse = [group[0] for group in grow(weights, min(clusters, COARSE), 1)]
    groups = grow(weights, clusters, texels)
    return _assemble(env, moments, groups, _clusters(_box_sums(moments, coarse), env))


def _assemble(env: EnvMap, moments: NDArray[np.float64], groups: list[list[Box]], coarse: Clusters) -> PreparedLight:
    """Arrays of the texels of every cluster [C][..] and, where a texel holds several cells, of the cells."""
    hulls = [_hull(group) for group in groups]
    count = sum(len(group) for group in groups)
    cells = [_cells(box) for box in hulls] if count < moments[..., 0].size else []
    flat = [box for group in groups + cells for box in group]
    sums = _box_sums(moments, flat)
    world = _direction(sums) @ env.world_from_map.T
    start = _starts(groups, 0)
    fine = _starts(cells, count) if cells else start
    sizes = np.diff(start), np.diff(fine) if cells else np.zeros(0, dtype=np.int32)
    return PreparedLight(
        direction=_columns(world),
        energy=_columns(sums[:, :3]),
        solid_angle=sums[:, 6].astype(np.float32),
        spread=_spread(sums, np.array([(b - a) * (d - c) for a, b, c, d in flat])).astype(np.float32),
        cluster_of=np.concatenate([np.repeat(np.arange(len(n)), n) for n in sizes]).astype(np.int32),
        coarse_start=start,
        fine_start=fine,
        clusters=_clusters(_box_sums(moments, hulls), env),
        coarse=coarse,
        cone=_cones([world[i : min(i + BLOCK, count)] for i in range(0, count, BLOCK)]),
        cluster_cone=_cones([world[a:b] for a, b in pairwise(fine)]),
        env=env,
    )


def _hull(boxes: list[Box]) -> Box:
    a, b, c, d = zip(*boxes, strict=True)
    return min(a), max(b), min(c), max(d)


def _cells(box: Box) -> list[Box]:
    a, b, c, d = box
    return [(i, i + 1, j, j + 1) for i in range(a, b) for j in range(c, d)]


def _starts(groups: list[list[Box]], first: int) -> NDArray[np.int32]:
    return (first + np.cumsum([0, *(len(group) for group in groups)])).astype(np.int32)


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
    rows, row_ends, columns, column_ends = np.array(boxes).T
    sums = moments[rows, columns]
    for i in np.flatnonzero((row_ends - rows) * (column_ends - columns) > 1):
        sums[i] = moments[rows[i] : row_ends[i], columns[i] : column_ends[i]].sum(axis=(0, 1))
    return sums


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


def _cones(parts: list[NDArray[np.float64]]) -> F32:
    """Axis and sine of the half angle of sets of directions [4, N]; 2 where the set fills a hemisphere."""
    cones = np.empty((4, len(parts)), dtype=np.float32)
    for i, part in enumerate(parts):
        axis = part.sum(axis=0) / max(float(np.linalg.norm(part.sum(axis=0))), 1e-30)
        cosine = float((part @ axis).min())
        cones[:3, i] = axis
        cones[3, i] = np.sqrt(max(1 - cosine**2, 0)) + 1e-5 if cosine > 0 else 2.0
    return cones
