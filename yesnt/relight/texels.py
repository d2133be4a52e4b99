"""Texels of a light at several levels of detail, laid out for vector instructions.

Every cluster has texels at every level. Level 0 are leaves of the tree, small where the light is strong. Each further
level is a regular cut of the cluster's cells, twice as fine along each side, down to single cells. A pixel reads from
each cluster the coarsest level that its lobe tolerates (relight/texel_lod.py): sharp lobes read fine texels where they
point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.relight.tree import Box

F32 = NDArray[np.float32]
Float = NDArray[np.float64]

LANES = 8
"""Texels per block. Clusters hold whole blocks; the rest of the last one is filled with texels of no light and size."""

_ROWS = ("x", "y", "z", "r", "g", "b", "solid angle", "spread")
_MOST_MERGED = 8  # columns of the grid that one texel covers near a pole, where cells are narrow


@dataclass(frozen=True)
class Texels:
    """Texels as structure of arrays, sorted by level, then by cluster; every cluster starts a block of eight.

    Attributes:
        rows: [8, N] unit direction x, y, z (world, luminance centroid); radiance times solid angle r, g, b; solid
            angle, sr; angular variance of the texel's light, rad^2. N includes filling at the end.
        start: [L, C + 1] first block of each cluster at each level.
        size: [L, C] mean angular size of a cluster's texels at each level, rad, coarse to fine.
    """

    rows: F32
    start: NDArray[np.int32]
    size: F32

    def __len__(self) -> int:
        """Number of texels of level 0, padding included."""
        return int(self.start[0, -1]) * LANES

    def level(self, level: int) -> F32:
        """Rows [8, T] of a level's texels, padding included."""
        return self.rows[:, LANES * self.start[level, 0] : LANES * self.start[level, -1]]

    def owner(self, level: int) -> NDArray[np.int64]:
        """Cluster [T] of each texel of a level, padding included."""
        return np.repeat(np.arange(self.start.shape[1] - 1), LANES * np.diff(self.start[level]))

    @property
    def coarsest(self) -> int:
        """Coarsest level that a pixel may read: -1 (a cluster as one texel), or 0 if every cell is a texel."""
        return -1 if len(self.start) > 1 else 0

    def finest(self, bearable: float) -> int:
        """Finest level that lobes need which bear texels of `bearable` rad or more everywhere."""
        enough = np.flatnonzero((self.size <= bearable).all(axis=1))
        return int(enough[0]) if len(enough) else len(self.start) - 1

    @cached_property
    def most_spread(self) -> float:
        """Largest angular variance of all texels, rad^2."""
        return float(self.rows[7].max())

    @property
    def direction(self) -> F32:
        """Rows [3, T] of level 0."""
        return self.level(0)[:3]

    @property
    def energy(self) -> F32:
        """Rows [3, T] of level 0."""
        return self.level(0)[3:6]

    @property
    def solid_angle(self) -> F32:
        """Row [T] of level 0, sr."""
        return self.level(0)[6]

    @cached_property
    def packed(self) -> Float:
        """Bits of `rows` block by block, [N / 8, 32] words of two texels: a block lies in four cache lines."""
        blocks = self.rows.reshape(len(_ROWS), -1, LANES).transpose(1, 0, 2)
        return np.ascontiguousarray(blocks).reshape(-1, len(_ROWS) * LANES).view(np.float64)


def cut_levels(moments: Float, groups: list[list[Box]], hulls: list[Box]) -> list[list[Float]]:
    """Sums [n, 11] over the texels of every level and cluster: moments (envmap.cell_moments) and number of cells.

    Args:
        moments: [h, w, 10].
        groups: boxes of the texels of level 0, per cluster.
        hulls: box of each cluster.
    """
    levels = [[_with_count(box_sums(moments, group), group) for group in groups]]
    cells, texels = moments.shape[0] * moments.shape[1], sum(len(group) for group in groups)
    if texels >= cells:
        return levels
    step = 1
    while (2 * step) ** 2 * texels < cells:
        step *= 2
    while step >= 1:
        levels.append([_regular(moments, hull, step) for hull in hulls])
        step //= 2
    return levels


def box_sums(moments: Float, boxes: list[Box]) -> Float:
    """Sums [T, k] of moments [h, w, k] over boxes; direct, since a summed-area table would cancel next to a sun."""
    rows, row_ends, columns, column_ends = np.array(boxes).T
    sums = moments[rows, columns]
    for i in np.flatnonzero((row_ends - rows) * (column_ends - columns) > 1):
        sums[i] = moments[rows[i] : row_ends[i], columns[i] : column_ends[i]].sum(axis=(0, 1))
    return sums


def _with_count(sums: Float, boxes: list[Box]) -> Float:
    """Appends the number of cells of each box as the last column."""
    cells = [(b - a) * (d - c) for a, b, c, d in boxes]
    return np.concatenate([sums, np.array(cells, dtype=float)[:, None]], axis=1)


def _regular(moments: Float, hull: Box, step: int) -> Float:
    """Sums of the cells of a box over squares of `step` x `step` cells, [n, 11]; over more columns near a pole.

    At step 1 each texel is one cell, so that a mirror is as sharp as with the full sum.
    """
    a, b, c, d = hull
    sine = np.sin(np.pi * 0.5 * (a + b) / moments.shape[0])
    most = _MOST_MERGED if step > 1 else 1
    across = step * int(2 ** np.floor(np.log2(np.clip(1 / max(sine, 1e-9), 1, most))))
    counted = np.concatenate([moments[a:b, c:d], np.ones((b - a, d - c, 1))], axis=2)
    rows = np.add.reduceat(counted, np.arange(0, b - a, step), axis=0)
    return np.add.reduceat(rows, np.arange(0, d - c, across), axis=1).reshape(-1, counted.shape[2])


def assemble(levels: list[list[Float]], world_from_map: Float) -> Texels:
    """Lays out the sums of `cut_levels` in blocks; `world_from_map` [3, 3] turns directions to world axes."""
    counts = np.array([[len(sums) for sums in level] for level in levels])
    ends = np.cumsum(-(-counts.ravel() // LANES))
    start = np.concatenate([[0], ends]).astype(np.int32)
    flat = np.concatenate([sums for level in levels for sums in level])
    owner = np.repeat(np.arange(counts.size), counts.ravel())
    first = np.cumsum(np.concatenate([[0], counts.ravel()[:-1]]))
    slot = np.arange(len(flat)) - first[owner] + start[owner] * LANES
    rows = np.zeros((len(_ROWS), odd_lines(int(start[-1]) * LANES)), dtype=np.float32)
    rows[2] = 1.0  # filling: no light, no size, but a direction
    rows[:3, slot] = (centroid(flat) @ world_from_map.T).T
    rows[3:6, slot], rows[6, slot], rows[7, slot] = flat[:, :3].T, flat[:, 6], spread(flat[:, :10], flat[:, 10])
    bounds = [start[level * counts.shape[1] :][: counts.shape[1] + 1] for level in range(len(counts))]
    solid = np.array([[sums[:, 6].sum() for sums in level] for level in levels])
    return Texels(rows, np.stack(bounds), np.sqrt(solid / counts).astype(np.float32))


def odd_lines(count: int) -> int:
    """Least length >= `count` floats that is an odd number of cache lines; even ones make rows share cache sets."""
    return 16 * (-(-count // 16) | 1)


def centroid(moments: Float) -> Float:
    """Unit direction [..., 3] of moments [..., 10]: luminance centroid; without light, that of the solid angle."""
    light, area = moments[..., 3:6], moments[..., 7:10]
    chosen = np.where(np.linalg.norm(light, axis=-1, keepdims=True) > 1e-30, light, area)
    length = np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.where(length > 1e-30, chosen / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))


def spread(sums: Float, cells: NDArray[np.floating]) -> Float:
    """Angular variance [n], rad^2, of the light of texels: 2 (1 - |mean direction|), plus that of one square cell.

    Args:
        sums: [n, 10] moments.
        cells: [n] number of cells of each texel.
    """
    light = luminance(sums[:, :3])
    weight, moment = np.where(light > 1e-30, light, sums[:, 6]), sums[:, 3:6]
    moment = np.where(light[:, None] > 1e-30, moment, sums[:, 7:10])
    mean = np.linalg.norm(moment, axis=1) / np.maximum(weight, 1e-300)
    return 2 * np.clip(1 - mean, 0, 1) + sums[:, 6] / cells / 6
