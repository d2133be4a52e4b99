"""Matte pixels as compact lists: neighbours in the frame and bilinear stencils along the flow.

A pixel's index counts matte pixels by frame, row, column. Everything the solver touches is per matte pixel, so its time
and memory follow the actor and not the frame. Both material channels share one `Geometry`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

HAS_RIGHT = 1
FIXED = 2


class Geometry(NamedTuple):
    """Index lists of N matte pixels in T frames (a named tuple, because numba's kernels take it as it is).

    Attributes:
        frames: [T + 1] int64, pixels of frame t are frames[t] .. frames[t + 1].
        flags: [N] uint8: HAS_RIGHT where the right neighbour is a matte pixel (its index is p + 1), FIXED where the
            value is given and not solved for.
        down: [N] int32 index of the pixel below, -1 where there is none.
        top: [N] int32 index of the stencil's upper left sample in frame t + 1; its right neighbour is top + 1.
        bottom: [N] int32, the same for the lower row.
        weights: [N, 4] float32 bilinear weights (top, top + 1, bottom, bottom + 1), renormalised over matte pixels.
        link: [N] float32 V in [0, 1]; 0 where the flow leaves the frame or the matte.
    """

    frames: NDArray[np.int64]
    flags: NDArray[np.uint8]
    down: NDArray[np.int32]
    top: NDArray[np.int32]
    bottom: NDArray[np.int32]
    weights: NDArray[np.float32]
    link: NDArray[np.float32]

    @property
    def pixels(self) -> int:
        """How many matte pixels there are in all frames."""
        return int(self.frames[-1])


def build_geometry(
    matte: NDArray[np.bool_],
    flow: NDArray[np.floating],
    validity: NDArray[np.floating] | NDArray[np.bool_],
    fixed: NDArray[np.bool_] | None = None,
) -> Geometry:
    """Lists the matte pixels `[T, H, W]` and their links.

    `flow` [T-1, H, W, 2] and `validity` [T-1, H, W] are as in `solve`; `fixed` [T, H, W] marks pixels whose value is given.
    """
    frames = np.concatenate([[0], np.cumsum(matte.reshape(len(matte), -1).sum(axis=1, dtype=np.int64))])
    if frames[-1] >= 2**31 - 1:
        raise ValueError(f"{frames[-1]} matte pixels: expected fewer than 2^31; solve in chunks or row bands")
    count = int(frames[-1])
    geometry = Geometry(
        frames=frames,
        flags=np.zeros(count, np.uint8),
        down=np.full(count, -1, np.int32),
        top=np.zeros(count, np.int32),
        bottom=np.zeros(count, np.int32),
        weights=np.zeros((count, 4), np.float32),
        link=np.zeros(count, np.float32),
    )
    index_now = _frame_index(matte[0], 0)
    for t in range(len(matte)):
        part = slice(int(frames[t]), int(frames[t + 1]))
        _neighbours(index_now, geometry.flags[part], geometry.down[part])
        if fixed is not None:
            geometry.flags[part] |= (FIXED * fixed[t][matte[t]]).astype(np.uint8)
        if t + 1 < len(matte):
            index_next = _frame_index(matte[t + 1], int(frames[t + 1]))
            _stencils(
                index_now,
                index_next,
                flow[t],
                validity[t],
                geometry.top[part],
                geometry.bottom[part],
                geometry.weights[part],
                geometry.link[part],
            )
            index_now = index_next
    return geometry


def _frame_index(matte: NDArray[np.bool_], first: int) -> NDArray[np.int32]:
    """[H, W] compact index of each matte pixel, -1 elsewhere."""
    index = np.full(matte.shape, -1, np.int32)
    index[matte] = np.arange(first, first + int(matte.sum()), dtype=np.int32)
    return index


@njit(cache=True)
def _neighbours(index, flags, down):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fills the spatial neighbours of one frame."""
    height, width = index.shape
    p = 0
    for i in range(height):
        for j in range(width):
            if index[i, j] >= 0:
                if j + 1 < width and index[i, j + 1] >= 0:
                    flags[p] |= HAS_RIGHT
                if i + 1 < height:
                    down[p] = index[i + 1, j]
                p += 1


@njit(cache=True)
def _row_stencil(index, row, x0, fx, share):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Index of the left sample and the weights of the two samples of one row; absent samples weigh 0."""
    width = index.shape[1]
    left = index[row, x0]
    right = index[row, x0 + 1] if x0 + 1 < width else -1
    w_left, w_right = share * (1.0 - fx), share * fx
    if left >= 0 and right >= 0:
        return left, w_left, w_right
    # One sample is absent: the present one is stored second, so that `top + 1` never leaves the list. Index 0 belongs
    # to the first frame, which no stencil samples, so `left - 1` is never negative.
    if left >= 0:
        return left - 1, 0.0, w_left
    if right >= 0:
        return right - 1, 0.0, w_right
    return -1, 0.0, 0.0


@njit(cache=True)
def _stencils(index_now, index_next, flow, validity, top, bottom, weights, link):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fills the bilinear stencils of one frame; positions are float64, so 4K columns keep their fraction."""
    height, width = index_now.shape
    p = 0
    for i in range(height):
        for j in range(width):
            if index_now[i, j] < 0:
                continue
            x, y = j + np.float64(flow[i, j, 0]), i + np.float64(flow[i, j, 1])
            if 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0 and validity[i, j] > 0:
                x0, y0 = int(x), int(y)
                fx, fy = x - x0, y - y0
                first, w0, w1 = _row_stencil(index_next, y0, x0, fx, 1.0 - fy)
                second, w2, w3 = -1, 0.0, 0.0
                if y0 + 1 < height:
                    second, w2, w3 = _row_stencil(index_next, y0 + 1, x0, fx, fy)
                total = w0 + w1 + w2 + w3
                if total >= 0.5:
                    top[p] = first if first >= 0 else second
                    bottom[p] = second if second >= 0 else first
                    weights[p, 0], weights[p, 1] = w0 / total, w1 / total
                    weights[p, 2], weights[p, 3] = w2 / total, w3 / total
                    link[p] = validity[i, j]
            p += 1
