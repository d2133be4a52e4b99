"""Matte pixels as compact lists: neighbours in the frame and bilinear stencils along the flow.

A pixel's index counts matte pixels by frame, row, column. All arrays of the solver have one entry per matte pixel, so
its time and memory depend on the size of the matte, not of the frame. All material channels share one `Geometry`.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from yesnt.core.compiled import compiled

listing = compiled(_nrt=False, no_cfunc_wrapper=True)
"""Decorator of functions that fill their caller's arrays: no reference counting (`_nrt`)."""

HAS_RIGHT = 1
FIXED = 2
HAS_DOWN = 4


class Frames(Protocol):
    """Frames that can be indexed by position: an array, or a reader."""

    def __getitem__(self, position: int, /) -> Any:
        """Returns the frame at a position."""


class Geometry(NamedTuple):
    """Index lists of N matte pixels in T frames (a named tuple, because Numba's kernels accept it).

    Attributes:
        frames: [T + 1] int64, pixels of frame t are frames[t] .. frames[t + 1].
        flags: [N] uint8: HAS_RIGHT where the right neighbour is a matte pixel (its index is p + 1), HAS_DOWN where the
            one below is, FIXED where the value is given and not solved for.
        down: [N] uint32 index of the pixel below, 0 where there is none.
        top: [N] uint32 index of the stencil's upper left sample in frame t + 1; its right neighbour is top + 1.
        bottom: [N] uint32, the same for the lower row.
        weights: [N, 4] float32 bilinear weights (top, top + 1, bottom, bottom + 1), renormalised over matte pixels.
        link: [N] float32 V in [0, 1]; 0 where the flow leaves the frame or the matte.
    """

    frames: NDArray[np.int64]
    flags: NDArray[np.uint8]
    down: NDArray[np.uint32]
    top: NDArray[np.uint32]
    bottom: NDArray[np.uint32]
    weights: NDArray[np.float32]
    link: NDArray[np.float32]

    @property
    def pixels(self) -> int:
        """Number of matte pixels in all frames."""
        return int(self.frames[-1])


class PackedMasks:
    """Masks [T, H, W], stored with one bit per pixel; indexing unpacks a frame."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.shape = shape
        self._bits = [np.zeros(0, np.uint8)] * shape[0]

    def __len__(self) -> int:
        return self.shape[0]

    def __setitem__(self, t: int, mask: NDArray[np.bool_]) -> None:
        self._bits[t] = np.packbits(mask)

    def __getitem__(self, t: int) -> NDArray[np.bool_]:
        _, height, width = self.shape
        return np.unpackbits(self._bits[t], count=height * width).view(np.bool_).reshape(height, width)


def build_geometry(
    matte: NDArray[np.bool_] | PackedMasks,
    flow: Frames,
    validity: Frames,
    fixed: NDArray[np.bool_] | PackedMasks | None = None,
) -> Geometry:
    """Lists the matte pixels and their links.

    Args:
        matte: [T, H, W].
        flow: [T-1, H, W, 2] as in `solve`, or a reader of frames; each frame is read once, in order.
        validity: [T-1, H, W] as in `solve`, or a reader of frames.
        fixed: [T, H, W], True where the value is given; None: nowhere.

    Raises:
        ValueError: the matte has 2^31 pixels or more.
    """
    frames = np.cumsum([0, *(np.count_nonzero(matte[t]) for t in range(len(matte)))])
    if frames[-1] >= 2**31 - 1:
        raise ValueError(f"{frames[-1]} matte pixels: expected fewer than 2^31; solve in chunks or row bands")
    count = int(frames[-1])
    geometry = Geometry(
        frames=frames,
        flags=np.zeros(count, np.uint8),
        down=np.zeros(count, np.uint32),
        top=np.zeros(count, np.uint32),
        bottom=np.zeros(count, np.uint32),
        weights=np.zeros((count, 4), np.float32),
        link=np.zeros(count, np.float32),
    )
    mask, index = matte[0], _frame_index(matte[0], 0)
    for t in range(len(matte)):
        part = slice(int(frames[t]), int(frames[t + 1]))
        _neighbours(index, geometry.flags[part], geometry.down[part])
        if fixed is not None:
            geometry.flags[part] |= (FIXED * fixed[t][mask]).astype(np.uint8)
        if t + 1 < len(matte):
            mask_next = matte[t + 1]
            index_next = _frame_index(mask_next, int(frames[t + 1]))
            if frames[t + 2] > frames[t + 1]:
                span = (int(frames[t + 1]), int(frames[t + 2]))
                links = (np.ascontiguousarray(array[t][mask]) for array in (flow, validity))
                _stencils(int(frames[t]), index, index_next, span, *links, geometry)
            mask, index = mask_next, index_next
    return geometry


def drop_spatial_term(geometry: Geometry, t: int, linked: NDArray[np.bool_]) -> None:
    """Removes the spatial term of the `linked` pixels [n] of frame t, in place.

    Where a frame has no data weight, the total variation alone would flatten it, and the frame would then pull at its
    neighbours through the links. Pixels without a link keep the term, because nothing else determines them.
    """
    geometry.flags[int(geometry.frames[t]) : int(geometry.frames[t + 1])][linked] &= FIXED


def _frame_index(matte: NDArray[np.bool_], first: int) -> NDArray[np.int32]:
    """[H, W] compact index of each matte pixel, -1 elsewhere."""
    index = np.full(matte.shape, -1, np.int32)
    index[matte] = np.arange(first, first + int(matte.sum()), dtype=np.int32)
    return index


@listing
def _neighbours(index, flags, down):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fills the spatial neighbours of one frame."""
    height, width = index.shape
    p = 0
    for i in range(height):
        for j in range(width):
            if index[i, j] >= 0:
                if j + 1 < width and index[i, j + 1] >= 0:
                    flags[p] |= HAS_RIGHT
                if i + 1 < height and index[i + 1, j] >= 0:
                    flags[p] |= HAS_DOWN
                    down[p] = index[i + 1, j]
                p += 1


@listing
def _row_stencil(index, first, last, row, x0, fx, share):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Index of the left sample of one row and the weights of the two; absent samples weigh 0.

    The pair of indices stays inside the frame's pixels first .. last - 1, so that threads never write each other's
    frames; a frame of a single pixel has no such pair and takes the one before it (see `frame_groups`).
    """
    height, width = index.shape
    left = index[row, x0] if row < height else -1
    right = index[row, x0 + 1] if row < height and x0 + 1 < width else -1
    w_left, w_right = share * (1.0 - fx), share * fx
    if left >= 0 and right >= 0:
        return left, w_left, w_right
    if left < 0 and right < 0:
        return (first if last - first > 1 else first - 1), 0.0, 0.0
    only, weight = (left, w_left) if left >= 0 else (right, w_right)
    if only == first and last - first > 1:
        return only, weight, 0.0
    return only - 1, 0.0, weight


@listing
def _stencils(first_now, index_now, index_next, span, flow, validity, geometry):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Fills the bilinear stencils of one frame's n pixels from their flow [n, 2] and validity [n].

    `first_now` is the index of the frame's first pixel, `span` is (first, last) of the next frame's pixels, of which
    there is at least one. Positions are float64, so that columns of a 4K frame keep their fraction.
    """
    first, last = span
    height, width = index_now.shape
    top, bottom, weights, link = geometry.top, geometry.bottom, geometry.weights, geometry.link
    n = 0
    for i in range(height):
        for j in range(width):
            if index_now[i, j] < 0:
                continue
            p = first_now + n
            top[p] = bottom[p] = first if last - first > 1 else first - 1
            x, y = j + np.float64(flow[n, 0]), i + np.float64(flow[n, 1])
            if 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0 and validity[n] > 0:
                x0, y0 = int(x), int(y)
                upper, w0, w1 = _row_stencil(index_next, first, last, y0, x0, x - x0, 1.0 - (y - y0))
                lower, w2, w3 = _row_stencil(index_next, first, last, y0 + 1, x0, x - x0, y - y0)
                total = w0 + w1 + w2 + w3
                if total >= 0.5:
                    top[p], bottom[p], link[p] = upper, lower, validity[n]
                    weights[p, 0], weights[p, 1] = w0 / total, w1 / total
                    weights[p, 2], weights[p, 3] = w2 / total, w3 / total
            n += 1
