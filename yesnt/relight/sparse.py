"""Sparse shadow rays: neighbouring pixels that see a light cluster alike answer for the pixels between them.

Every fourth pixel of every fourth row (an anchor) is traced towards every cluster. Then follow the pixels half way
between anchors, then those between all of these. Where the four neighbours of a pixel lie on one surface and agree
whether a cluster is occluded, the pixel takes their answer. Towards all other clusters it is traced. Shadow edges stay
as sharp as with every ray. Occluders thinner than the distance of the neighbours are lost (docs/relight.md has the
measured error).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.compiled import exact_entry, exact_kernel
from yesnt.relight.lights import Clusters
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

STEP = 4
"""Rows and columns between the pixels that are traced towards every cluster."""

_SAME_WAY = 0.97  # least cosine of the normals of two pixels of one surface
_APART = 6.0  # largest distance of their points, in footprints of a pixel, for every pixel from one to the other
_LEAN = 0.5  # largest share of that distance along the normal: more is a step in depth

_BEFORE, _AFTER = np.int64(-1), np.int64(1)  # typed: of plain numbers Numba would compile a variant each


@dataclass(frozen=True)
class Band:
    """A range of pixels and the row of anchors below it.

    Attributes:
        part: the pixels that are wanted.
        whole: these and those of the next anchor row, which the last rows of the band take answers from.
    """

    part: slice
    whole: slice


def bands(pixels: Pixels, size: int) -> list[Band]:
    """Cuts pixels into bands of about `size` pixels that begin at rows of anchors, so that no cut changes a hit."""
    rows = pixels.index // pixels.shape[1]
    starts = np.searchsorted(rows, np.arange(0, pixels.shape[0] + STEP, STEP))
    ends = np.searchsorted(rows, np.arange(0, pixels.shape[0] + STEP, STEP) + 1)
    cuts, found = [0], []
    for i, start in enumerate(starts):
        last = i == len(starts) - 1
        if start > cuts[-1] and (last or starts[i + 1] - cuts[-1] > size):
            found.append(Band(slice(cuts[-1], int(start)), slice(cuts[-1], int(ends[i]))))
            cuts.append(int(start))
    return found


class PixelGrid(NamedTuple):
    """The pixels of a band, by number and by place in the image.

    Attributes:
        row: [N] row in the image.
        column: [N] column in the image.
        first: row of the first pixel.
        number: [rows, W] number of the pixel at each place from row `first` on, -1 where there is none.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    first: int
    number: I32


class PixelSurface(NamedTuple):
    """What tells whether two pixels lie on one surface.

    Attributes:
        position: [N, 3] world metres.
        normal: [N, 3] unit, world.
        footprint: [N] metres that a pixel covers at its depth.
    """

    position: F32
    normal: F32
    footprint: F32


def sparse_hits(proxy: ProxyScene, origins: F32, pixels: Pixels, band: Band, light: Clusters, footprint: F32) -> I32:
    """As `ProxyScene.cluster_hits` of the band's pixels, [P, C], most of them taken from their neighbours.

    Args:
        proxy: the mesh.
        origins: [all, 3] origins of the frame's shadow rays, world metres.
        pixels: of the frame.
        band: which of them.
        light: the C clusters.
        footprint: [all] metres that a pixel covers at its depth.
    """
    part, width = band.whole, pixels.shape[1]
    start, normal = origins[part], pixels.normal[part]
    row, column = pixels.index[part] // width, pixels.index[part] % width
    first = int(row[0]) if len(row) else 0
    number = np.full((int(row[-1]) - first + 1 if len(row) else 0, width), -1, dtype=np.int32)
    number[row - first, column] = np.arange(len(row))
    grid = PixelGrid(row, column, first, number)
    surface = PixelSurface(pixels.position[part], normal, footprint[part])
    hits = np.full((len(row), len(light)), -1, dtype=np.int32)
    done = (row % STEP == 0) & (column % STEP == 0)
    hits[done] = proxy.cluster_hits(start[done], normal[done], light)
    step = STEP // 2
    while step >= 1:
        level = np.flatnonzero((row % step == 0) & (column % step == 0) & ~done)
        done[level] = True
        unknown = _take_from_neighbours(level, step, grid, surface, hits)
        asked = np.flatnonzero(unknown.any(axis=1))
        traced = proxy.cluster_hits(start[level[asked]], normal[level[asked]], light, unknown[asked])
        hits[level[asked]] = np.where(unknown[asked], traced, hits[level[asked]])
        step //= 2
    return hits[: band.part.stop - band.part.start]


def _take_from_neighbours(
    level: NDArray[np.int64], step: int, grid: PixelGrid, surface: PixelSurface, hits: I32
) -> NDArray[np.bool_]:
    """Writes the hits that all neighbours of the pixels `level` [L] agree on; [L, C] True where they do not."""
    unknown = np.zeros((len(level), hits.shape[1]), dtype=np.bool_)
    over_ranges(
        len(level), lambda first, last: _agreed_hits(first, last, level, step, grid, surface, hits, unknown)
    )  # fmt: skip
    return unknown


@exact_entry
def _agreed_hits(first, last, level, step, grid, surface, hits, unknown):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the hits that all neighbours agree on, and marks the clusters where they do not."""
    for i in range(first, last):
        p = level[i]
        a = _neighbour(p, step, _BEFORE, _BEFORE, grid, surface)
        b = _neighbour(p, step, _BEFORE, _AFTER, grid, surface)
        c = _neighbour(p, step, _AFTER, _BEFORE, grid, surface)
        d = _neighbour(p, step, _AFTER, _AFTER, grid, surface)
        if a < 0 or b < 0 or c < 0 or d < 0:
            unknown[i, :] = True
            continue
        for k in range(hits.shape[1]):
            occluded = hits[a, k] >= 0
            agreed = (hits[b, k] >= 0) == occluded
            agreed &= (hits[c, k] >= 0) == occluded
            agreed &= (hits[d, k] >= 0) == occluded
            hits[p, k] = hits[a, k]
            unknown[i, k] = not agreed


@exact_kernel
def _neighbour(p, step, down, across, grid, surface):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Number of the pixel `step` rows and columns away from pixel p; -1 if it is absent or on another surface.

    Along an axis on which p lies on the coarser grid, the offset is 0: two of the four neighbours are then the same.
    """
    y = grid.row[p] - grid.first + down * step * (grid.row[p] // step % 2)
    x = grid.column[p] + across * step * (grid.column[p] // step % 2)
    if y < 0 or x < 0 or y >= grid.number.shape[0] or x >= grid.number.shape[1]:
        return np.int32(-1)
    q = grid.number[y, x]
    if q < 0 or not _one_surface(p, q, step, surface):
        return np.int32(-1)
    return q


@exact_kernel
def _one_surface(p, q, step, surface):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether pixels p and q have similar normals and lie near each other, along the surface."""
    position, normal, footprint = surface
    cosine = apart = along = np.float32(0)
    for k in range(3):
        d = position[q, k] - position[p, k]
        cosine += normal[p, k] * normal[q, k]
        along += d * normal[p, k]
        apart += d * d
    apart = np.sqrt(apart)
    return cosine > _SAME_WAY and apart < _APART * step * footprint[p] and abs(along) <= _LEAN * apart
