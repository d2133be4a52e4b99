"""Records of arrays that the compiled kernels take. Numba reads the fields of a named tuple at no cost.

P pixels, C light clusters, L levels of texels, N texels with filling, B = N / 8 blocks of texels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

X, Y, Z, RED, GREEN, BLUE, SOLID_ANGLE, SPREAD = range(8)
"""Rows of texels or clusters [8, N]: unit direction (world, luminance centroid); radiance times solid angle; solid
angle, sr; angular variance of the light, rad^2."""

NO_DIFFUSE, LAMBERT, DISNEY = np.int32(0), np.int32(1), np.int32(2)
"""Values of `Lobes.diffuse`."""

SCRATCH_TEXELS = 1024
"""Texels that are gathered at a time: 32 kB, which stay in the cache of a core."""

_STRIDE = SCRATCH_TEXELS + 16  # floats from row to row of the scratch: rows a power of two apart share a cache set

FEW = 4
"""Blocks of a cluster that are gathered one by one; to start a loop where they lie costs as much."""


class ShadingPoints(NamedTuple):
    """Pixels as the kernels read them.

    Attributes:
        normal: [3, P] unit, world.
        viewer: [3, P] unit, world, towards the camera (Numba has no field `view`).
        alpha: [P] alpha_ggx.
        dielectric: [P] uint8, 1 where the dielectric lobe is wanted.
        metal: [P] uint8, 1 where the metallic (Schlick) lobe is wanted.
        disney: the diffuse is Burley's instead of Lambert's.
    """

    normal: F32
    viewer: F32
    alpha: F32
    dielectric: U8
    metal: U8
    disney: bool = False


class TexelArrays(NamedTuple):
    """Texels of a light at the levels that the pixels need; see `texels.Texels`.

    Attributes:
        rows: [8, N] float32.
        words: [B, 32] float64, the bits of `rows` block by block.
        start: [L, C + 1] int32, first block of each cluster at each level.
        size: [L, C] float32, mean angular size of a cluster's texels at each level, rad, coarse to fine.
    """

    rows: F32
    words: NDArray[np.float64]
    start: I32
    size: F32


class ClusterArrays(NamedTuple):
    """Clusters of a light; see `lights.PreparedLight`.

    Attributes:
        cone: [4, C] axis and sine of the half angle.
        moment: [12, C] energy and solid angle times direction.
        rows: [8, C] each cluster as one texel.
        edge: [8, C] how a cluster passes the horizon; [8, 0] if texels tell that.
    """

    cone: F32
    moment: F32
    rows: F32
    edge: F32


class Occlusion(NamedTuple):
    """What hides the light from pixels.

    Attributes:
        hidden: [P, C] bool, the cluster is occluded; [0, 0] if none is.
        indirect: [3, P, C] radiance that comes from an occluded cluster's direction; [3, 0, 0] for none.
    """

    hidden: NDArray[np.bool_]
    indirect: F32


class Sampling(NamedTuple):
    """How finely a light is sampled.

    Attributes:
        detail: angular size of a texel over the width of the lobe where it lies, at most.
        widen: squared radius of a texel's disc of half vectors over its angular variance, times n.v; 0: points.
        coarsest: level that a pixel may begin at: -1 a cluster as one texel, else 0.
        most_spread: largest angular variance of all texels, rad^2.
    """

    detail: np.float32
    widen: np.float32
    coarsest: int
    most_spread: np.float32


class Lobes(NamedTuple):
    """Lobes that a sum is taken over.

    Attributes:
        diffuse: NO_DIFFUSE, LAMBERT or DISNEY.
        dielectric: the specular lobe of a dielectric.
        metal: the two parts of the specular lobe of a metal.
        broad: the specular lobes are wide enough for their cheaper forms (`lobes.is_broad`).
    """

    diffuse: np.int32
    dielectric: np.bool_
    metal: np.bool_
    broad: np.bool_


class ClusterState(NamedTuple):
    """Clusters as one pixel sees them; all [C].

    Attributes:
        cosine: float32, n.l of the cone's axis.
        level: int32, level of its texels; -1 the cluster as one texel.
        hidden: uint8, 1 where it is occluded.
        bearable: float32, size of the texels that the lobe bears there, rad.
        finest: int32 zeros, level 0 for all.
    """

    cosine: F32
    level: I32
    hidden: U8
    bearable: F32
    finest: I32


class BlockList(NamedTuple):
    """Blocks of texels that one pixel sums.

    Attributes:
        mask: [C] uint8, clusters that take part.
        clusters: [C + 1] intp, their numbers.
        runs: [C, 2] int32, first and last block of runs that are summed where they lie.
        blocks: [4 C + 4] int32, single blocks that are gathered.
    """

    mask: U8
    clusters: NDArray[np.intp]
    runs: I32
    blocks: I32


class Scratch(NamedTuple):
    """Memory of one thread, reused from pixel to pixel.

    Attributes:
        state: clusters as the pixel sees them.
        listed: blocks that it sums.
        frame: [12] float32, the stored ShadingFrame.
        words: [8, S / 2] float64, gathered texels.
        texels: [8, S] float32, the same memory.
        whole: [8, C] float32, clusters that are read as one texel each.
        occluded: [8, C] float32, occluded clusters.
        open: [20] float32, lobe sums of occluded clusters as if they were not.
    """

    state: ClusterState
    listed: BlockList
    frame: F32
    words: NDArray[np.float64]
    texels: F32
    whole: F32
    occluded: F32
    open: F32


def new_scratch(cluster_rows: F32, columns: int, frame_size: int) -> Scratch:
    """Memory for one thread and clusters [8, C]."""
    count = cluster_rows.shape[1]
    state = ClusterState(
        np.empty(count, np.float32), np.empty(count, np.int32), np.zeros(count, np.uint8),
        np.empty(count, np.float32), np.zeros(count, np.int32),
    )  # fmt: skip
    listed = BlockList(
        np.empty(count, np.uint8), np.empty(count + 1, np.intp), np.empty((count, 2), np.int32),
        np.empty((count + 1) * FEW, np.int32),
    )  # fmt: skip
    words = np.empty((8, _STRIDE // 2), dtype=np.float64)
    frame, open_ = np.empty(frame_size, np.float32), np.empty(columns, np.float32)
    return Scratch(state, listed, frame, words, words.view(np.float32), cluster_rows.copy(), cluster_rows.copy(), open_)
