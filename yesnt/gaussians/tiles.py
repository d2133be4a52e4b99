"""Which Gaussians each tile composites, nearest first, and the slot of each pair of Gaussian and tile."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from yesnt.gaussians.compiled import entry


class TileLists(NamedTuple):
    """P pairs of Gaussian and tile.

    Attributes:
        starts: [T + 1] first pair of each tile, rows of tiles first.
        members: [P] Gaussian of each pair, nearest first within a tile.
        slots: [P] where the gradient of each pair is kept: pairs of one Gaussian are neighbours, in order of tiles.
        own: [N + 1] first slot of each Gaussian.
    """

    starts: Any
    members: Any
    slots: Any
    own: Any


@entry
def tile_lists(order: Any, boxes: Any, tiles: Any, columns: Any, rows: Any) -> Any:
    """Lists of all tiles by counting; `order` [N] holds the Gaussians, nearest first."""
    count = len(order)
    starts, own = np.zeros(columns * rows + 1, np.int64), np.zeros(count + 1, np.int64)
    for i in range(count):
        own[i + 1] = own[i] + tiles[i]
        if tiles[i] > 0:
            for row in range(boxes[i, 2], boxes[i, 3]):
                for column in range(boxes[i, 0], boxes[i, 1]):
                    starts[row * columns + column + 1] += 1
    for tile in range(columns * rows):
        starts[tile + 1] += starts[tile]
    members, slots = np.empty(own[count], np.int32), np.empty(own[count], np.int64)
    free = starts[:-1].copy()
    for i in order:
        if tiles[i] == 0:
            continue
        slot = own[i]
        for row in range(boxes[i, 2], boxes[i, 3]):
            for column in range(boxes[i, 0], boxes[i, 1]):
                place = free[row * columns + column]
                members[place], slots[place] = i, slot
                free[row * columns + column] = place + 1
                slot += 1
    return TileLists(starts, members, slots, own)
