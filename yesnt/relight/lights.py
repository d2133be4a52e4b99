"""An environment map prepared for the kernels: texels of several sizes, clusters for visibility, cones for culling.

Source: docs/method.md section 5 (one visibility per light cluster); docs/relight.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.envmap import EnvMap, cell_moments
from yesnt.relight.predict import cluster_error, enough_clusters, light_radius
from yesnt.relight.texels import LANES, Texels, assemble, box_sums, centroid, cut_levels, spread
from yesnt.relight.tree import Box, grow, importance

F32 = NDArray[np.float32]
Float = NDArray[np.float64]

COARSE = 64
"""Clusters that light the triangles of the proxy: indirect radiance is a small, smooth part of the result."""

GRID_ROWS = 128
"""Rows of the finest grid that texels are cut from, unless the caller asks for another: 1.4 degrees per cell."""

EVEN = 128
"""Number of clusters from which a cluster that the horizon cuts is taken for an even square. Fewer are too large: light
of a bright side leaks to normals that receive hardly any (tests/relight/test_irradiance.py bounds the error)."""

DETAIL = 0.45
"""Default of `PreparedLight.detail`."""


@dataclass(frozen=True)
class Clusters:
    """C parts of a map, each represented by one direction.

    Attributes:
        direction: [3, C] unit, world; luminance centroid.
        energy: [3, C] radiance times solid angle.
        solid_angle: [C] sr.
        reach: [C] sine of the angular radius: how far below the horizon the centre may lie while a part is above it.
        spread: [C] angular variance of the cluster's light, rad^2.
    """

    direction: F32
    energy: F32
    solid_angle: F32
    reach: F32
    spread: F32

    def __len__(self) -> int:
        """Number of clusters."""
        return self.direction.shape[1]

    def nearest(self, direction: F32) -> NDArray[np.int32]:
        """Cluster [N] that each unit direction [N, 3] lies in: the nearest one, in units of its own angular radius."""
        apart = (1 - direction @ self.direction) / self.solid_angle
        return apart.argmin(axis=1).astype(np.int32)


class LightGrid(NamedTuple):
    """How a map is cut: boxes of cells of a lat-long grid.

    Attributes:
        size: rows and columns of the grid.
        coarse: boxes of the coarse clusters.
        groups: boxes of the texels of level 0, per cluster.
        hulls: box of each cluster.
    """

    size: tuple[int, int]
    coarse: list[Box]
    groups: list[list[Box]]
    hulls: list[Box]


@dataclass(frozen=True, eq=False)
class PreparedLight:
    """A map as the kernels read it, with C clusters.

    Attributes:
        texels: at all levels of detail.
        clusters: parts of the map that each have one visibility.
        coarse: fewer clusters, for the light that the triangles of the proxy receive.
        cone: [4, C] axis (unit, world) and sine of the half angle of every cluster; sine 2: wider than a hemisphere.
        moment: [12, C] energy times direction (r x, r y, r z, g x, ...) and solid angle times direction of every
            cluster: the irradiance of a cluster above the horizon is linear in the normal.
        edge: [8, C] half the width over which a cluster passes the horizon, times its energy (r, g, b) and solid angle,
            then half of the inverse of each one's root, 0 where there is none. [8, 0] of fewer than EVEN clusters.
        detail: largest angular size of a texel over the width of the lobe there.
        env: the map.
        grid: how the map is cut.
        shadow_error: predicted display error of one visibility per cluster (relight/predict.py).
        whole: of a part of a light (`part_of`), the light; None: it is a whole light itself.
    """

    texels: Texels
    clusters: Clusters
    coarse: Clusters
    cone: F32
    moment: F32
    edge: F32
    detail: float
    env: EnvMap
    grid: LightGrid
    shadow_error: float = 0.0
    whole: PreparedLight | None = None

    @property
    def undivided(self) -> PreparedLight:
        """The light that decides how finely and where light is looked for: parts of it sum up only if they agree."""
        return self if self.whole is None else self.whole


def prepare_light(
    env: EnvMap,
    texels: int,
    clusters: int,
    rows: int = GRID_ROWS,
    least: int = 1,
    detail: float = DETAIL,
    error: float = 0.0,
) -> PreparedLight:
    """Cuts a map into clusters and these into texels, on a lat-long grid of cells.

    A map of no more than `rows` rows is cut along its own texels. The sum of energy equals that of the map to rounding
    at any setting. Pure: the same map gives the same bits.

    Args:
        env: the map.
        texels: number of texels of level 0, about; with at least one per cell there is only that level.
        clusters: largest number of clusters.
        rows: largest number of rows of the grid, which has twice as many columns.
        least: a map of fewer rows is first subdivided to so many.
        detail: largest angular size of a texel over the width of a lobe.
        error: display error that fewer clusters may cost by prediction; 0 makes all clusters.
    """
    height, width = env.radiance.shape[:2]
    size = min(rows, max(height, least)), min(2 * rows, max(width, 2 * least))
    moments = cell_moments(env, size)
    light = np.asarray(luminance(moments[..., :3]), dtype=np.float64)
    weights = importance(light, centroid(moments), moments[..., 6])
    clusters = clusters if error == 0 else enough_clusters(weights, moments, error, clusters)
    coarse = [group[0] for group in grow(weights, min(clusters, COARSE), 1)]
    groups = grow(weights, clusters, texels, LANES)
    hulls = [_hull(group) for group in groups]
    cut, parts = assemble(cut_levels(moments, groups, hulls), env.world_from_map), _clusters(moments, hulls, env)
    return PreparedLight(
        texels=cut,
        clusters=parts,
        coarse=_clusters(moments, coarse, env),
        cone=_cones(cut),
        moment=_first_moments(cut),
        edge=_edges(parts),
        detail=detail,
        env=env,
        grid=LightGrid(size, coarse, groups, hulls),
        shadow_error=cluster_error(moments, hulls, light_radius(moments)),
    )


def part_of(light: PreparedLight, env: EnvMap) -> PreparedLight:
    """A part of a light, such as its sun: cut as the light is, seen in the same directions, with its own energy.

    What parts give therefore sums up to what the light gives.

    Args:
        light: the whole light.
        env: the part's map, of the size and rotation of the light's and nowhere brighter.
    """
    grid = light.grid
    moments = cell_moments(env, grid.size)
    own = assemble(cut_levels(moments, grid.groups, grid.hulls), env.world_from_map)
    rows = light.texels.rows.copy()
    rows[3:6] = own.rows[3:6]
    texels = Texels(rows, light.texels.start, light.texels.size)
    clusters = replace(light.clusters, energy=_clusters(moments, grid.hulls, env).energy)
    coarse = replace(light.coarse, energy=_clusters(moments, grid.coarse, env).energy)
    return replace(
        light, texels=texels, clusters=clusters, coarse=coarse, moment=_first_moments(texels), edge=_edges(clusters),
        env=env, whole=light,
    )  # fmt: skip


def _hull(boxes: list[Box]) -> Box:
    """Smallest box that holds all boxes."""
    a, b, c, d = zip(*boxes, strict=True)
    return min(a), max(b), min(c), max(d)


def _clusters(moments: Float, boxes: list[Box], env: EnvMap) -> Clusters:
    """Clusters of boxes of cells, turned to world axes."""
    sums = box_sums(moments, boxes)
    solid = sums[:, 6]
    reach = np.minimum(1.5 * np.sqrt(solid / np.pi), 1.0)  # 1.5: boxes up to about 2:1 fit inside
    cells = np.array([(b - a) * (d - c) for a, b, c, d in boxes])
    columns = (centroid(sums) @ env.world_from_map.T).T, sums[:, :3].T, solid, reach, spread(sums, cells)
    return Clusters(*(np.ascontiguousarray(a, dtype=np.float32) for a in columns))


def uniform_light(radiance: float = 1.0) -> EnvMap:
    """Map of one radiance from everywhere: the capture light that is assumed if none is given."""
    return EnvMap.from_array(np.full((16, 32, 3), radiance, dtype=np.float32))


def _cones(texels: Texels) -> F32:
    """`PreparedLight.cone`, from the texels of the first and last level."""
    levels = [(texels.level(i), texels.owner(i)) for i in {0, len(texels.start) - 1}]
    count = texels.start.shape[1] - 1
    cones = np.empty((4, count), dtype=np.float32)
    for c in range(count):
        rows = np.concatenate([level[:, owner == c] for level, owner in levels], axis=1).astype(np.float64)
        part = rows[:3, rows[6] > 0].T
        axis = part.sum(axis=0) / max(float(np.linalg.norm(part.sum(axis=0))), 1e-30)
        cosine = float((part @ axis).min())
        cones[:3, c] = axis
        cones[3, c] = np.sqrt(max(1 - cosine**2, 0)) + 1e-5 if cosine > 0 else 2.0
    return cones


def _first_moments(texels: Texels) -> F32:
    """`PreparedLight.moment`, from the texels of level 0, so that it agrees with their sums."""
    rows, owner = texels.level(0).astype(np.float64), texels.owner(0)
    count = texels.start.shape[1] - 1
    columns = [np.bincount(owner, rows[k] * rows[axis], count) for k in (3, 4, 5, 6) for axis in range(3)]
    return np.stack(columns).astype(np.float32)


def _edges(clusters: Clusters) -> F32:
    """`PreparedLight.edge`: the variance of an even square along an axis is a third of its half width squared."""
    if len(clusters) < EVEN:
        return np.zeros((8, 0), dtype=np.float32)
    weight = np.concatenate([clusters.energy, clusters.solid_angle[None]]).astype(np.float64)
    half = weight * np.sqrt(1.5 * clusters.spread.astype(np.float64))
    over = np.where(half > 1e-30, 0.5 / np.sqrt(np.maximum(half, 1e-30)), 0.0)
    return np.concatenate([half, over]).astype(np.float32)
