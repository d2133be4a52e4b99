"""Shadow rays where they are needed: neighbours that see a light cluster alike speak for the pixels between them.

Every fourth pixel of every fourth row is traced. Then come the pixels half way between, then those between these: where
all traced or told neighbours lie on the same surface and agree whether a cluster is hidden, so does the pixel; towards
all other clusters it is traced. Shadow edges stay as sharp as before; lost is what is thinner than the distance of the
neighbours at one place and one cluster (docs/relight.md says how much that is).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from yesnt.relight.lights import Clusters
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import ProxyScene

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

STEP = 4
"""Rows and columns between the pixels that are traced towards every cluster."""

_SAME_WAY = 0.97  # least cosine of the normals of two pixels of one surface
_APART = 6.0  # pixels' footprints that they may lie apart, for every pixel between them
_LEAN = 0.5  # of their distance that may lie along the normal: more is a step in depth


@dataclass(frozen=True)
class Band:
    """A range of pixels and the row of anchors below it.

    Attributes:
        part: the pixels that are wanted.
        whole: these and those of the next anchor row, whose hits the band's last rows are told from.
    """

    part: slice
    whole: slice


def bands(pixels: Pixels, size: int) -> list[Band]:
    """Cuts pixels into bands of about `size` that begin at rows of anchors, so that no cut changes a hit."""
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


def sparse_hits(proxy: ProxyScene, origins: F32, pixels: Pixels, band: Band, light: Clusters, footprint: F32) -> I32:
    """As `ProxyScene.cluster_hits` of the band's pixels [P, C], most of them told by their neighbours.

    Args:
        proxy: the mesh.
        origins: [all, 3] of the frame's shadow rays.
        pixels: of the frame.
        band: which of them.
        light: the clusters.
        footprint: [all] metres that a pixel covers at its depth.
    """
    part, width = band.whole, pixels.shape[1]
    start, normal = origins[part], pixels.normal[part]
    row, column = pixels.index[part] // width, pixels.index[part] % width
    first = int(row[0]) if len(row) else 0
    place = np.full((int(row[-1]) - first + 1 if len(row) else 0, width), -1, dtype=np.int32)
    place[row - first, column] = np.arange(len(row))
    hits = np.full((len(row), len(light)), -1, dtype=np.int32)
    anchors = (row % STEP == 0) & (column % STEP == 0)
    hits[anchors] = proxy.cluster_hits(start[anchors], normal[anchors], light)
    surface = (pixels.position[part], normal, footprint[part])
    step = STEP // 2
    while step >= 1:
        level = np.flatnonzero((row % step == 0) & (column % step == 0) & ~anchors)
        anchors[level] = True
        open_questions = np.zeros((len(level), len(light)), dtype=np.bool_)
        _ask_neighbours(level, (row, column, first, step), place, surface, hits, open_questions)
        asked = np.flatnonzero(open_questions.any(axis=1))
        traced = proxy.cluster_hits(start[level[asked]], normal[level[asked]], light, open_questions[asked])
        hits[level[asked]] = np.where(open_questions[asked], traced, hits[level[asked]])
        step //= 2
    return hits[: band.part.stop - band.part.start]


@njit(cache=True, parallel=True, error_model="numpy")
def _ask_neighbours(level, grid, place, surface, hits, unknown):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the hits that all neighbours agree on, and marks the clusters where they do not."""
    row, column, first, step = grid
    for i in prange(level.shape[0]):
        p = level[i]
        near = np.empty(4, dtype=np.int64)
        if not _neighbours(
            p, row[p] - first, column[p], (row[p] // step % 2, column[p] // step % 2, step), place, surface, near
        ):
            unknown[i, :] = True
            continue
        for c in range(hits.shape[1]):
            one = hits[near[0], c]
            alike = True
            for k in range(1, 4):
                alike &= (hits[near[k], c] >= 0) == (one >= 0)
            hits[p, c] = one
            unknown[i, c] = not alike


@njit(cache=True, error_model="numpy")
def _neighbours(p, y, x, odd, place, surface, near):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the four pixels around p (two, twice, on a line of the grid); False if one is absent or apart."""
    down, across = odd[0] * odd[2], odd[1] * odd[2]
    for k in range(4):
        j, i = y + (down if k & 1 else -down), x + (across if k & 2 else -across)
        if j < 0 or i < 0 or j >= place.shape[0] or i >= place.shape[1] or place[j, i] < 0:
            return False
        near[k] = place[j, i]
        if not _one_surface(p, near[k], odd[2], surface):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _one_surface(p, q, step, surface):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    position, normal, footprint = surface
    facing = apart = along = np.float32(0)
    for k in range(3):
        d = position[q, k] - position[p, k]
        facing += normal[p, k] * normal[q, k]
        along += d * normal[p, k]
        apart += d * d
    apart = np.sqrt(apart)
    return facing > _SAME_WAY and apart < _APART * step * footprint[p] and abs(along) <= _LEAN * apart
