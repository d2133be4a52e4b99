"""Forward and backward pass of the rasteriser over all tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.backward import SUMS, tile_gradients
from yesnt.gaussians.composite import CHANNELS, Accumulated, composite_tiles
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.project import SPLAT, TILE, GaussianArrays, Pinhole, Projected, project
from yesnt.gaussians.records import View
from yesnt.gaussians.tiles import TileLists, tile_lists
from yesnt.gaussians.unproject import FieldGradient, unproject
from yesnt.relight.ranges import over_ranges

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class Raster:
    """The result of a forward pass and what the backward pass needs.

    Attributes:
        gaussians: as rendered.
        images: [12, H, W] (composite.py: CHANNELS), a view of whole tiles.
        accumulated: the same over whole tiles.
    """

    gaussians: GaussianArrays
    images: F32
    accumulated: Accumulated
    projected: Projected
    lists: TileLists
    pinhole: Pinhole


def arrays_of(field: GaussianField) -> GaussianArrays:
    """The arrays of a field as the kernels take them."""
    added = np.zeros(field.count, np.float32) if field.filter_3d is None else field.filter_3d**2
    return GaussianArrays(
        field.positions, field.log_scales, field.rotations, field.opacity_logits, field.harmonics, added
    )


def pinhole_of(view: View, center: NDArray[np.floating], near: float) -> Pinhole:
    """A view as numbers; depths are squared about that of the world point `center`."""
    reference = float((view.rotation @ (np.asarray(center, np.float64) - view.position))[2])
    numbers = (float(view.fx), float(view.fy), float(view.cx), float(view.cy), int(view.width), int(view.height))
    rotation, position = (
        np.ascontiguousarray(view.rotation, np.float64),
        np.ascontiguousarray(view.position, np.float64),
    )
    return Pinhole(rotation, position, *numbers, float(near), reference)


def rasterise(gaussians: GaussianArrays, pinhole: Pinhole) -> Raster:
    """Renders Gaussians for a view. The bits do not depend on the number of threads."""
    count = len(gaussians.positions)
    projected = Projected(
        np.zeros((count, SPLAT), np.float32), np.zeros((count, 6), np.int32), np.zeros(count, np.int32)
    )
    over_ranges(count, lambda first, last: project(first, last, gaussians, pinhole, projected))
    order = np.argsort(projected.splats[:, 10], kind="stable").astype(np.int32)
    rows, columns = -(-pinhole.height // TILE), -(-pinhole.width // TILE)
    lists = tile_lists(order, projected.boxes, projected.tiles, columns, rows)
    out = Accumulated(
        np.empty((CHANNELS, rows * TILE, columns * TILE), np.float32), np.empty((rows * TILE, columns * TILE), np.int32)
    )
    over_ranges(rows * columns, lambda first, last: composite_tiles(first, last, projected, lists, pinhole, out))
    return Raster(gaussians, out.images[:, : pinhole.height, : pinhole.width], out, projected, lists, pinhole)


def backpropagate(gaussians: GaussianArrays, raster: Raster, gradient: F32) -> FieldGradient:
    """Gradients of a field from those of its images.

    Args:
        gaussians: as rendered.
        raster: the forward pass.
        gradient: [10, H, W] by colour (3), normal (3, camera axes, not normalised), sum of weights, weighted depth and
            its square (about the reference depth), and median depth.
    """
    sums = np.empty((len(raster.lists.members), SUMS), np.float32)
    rest = (raster.projected, raster.lists)
    tiles = len(raster.lists.starts) - 1
    over_ranges(tiles, lambda a, z: tile_gradients(a, z, *rest, raster.pinhole, raster.accumulated, gradient, sums))
    a, b, c, d, e = (np.zeros_like(part) for part in gaussians[:5])
    out = FieldGradient(a, b, c, d, e, np.zeros(len(gaussians.positions), np.float32))
    over_ranges(len(gaussians.positions), lambda a, z: unproject(a, z, gaussians, raster.pinhole, *rest, sums, out))
    return out
