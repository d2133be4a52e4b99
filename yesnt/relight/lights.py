"""An env map made ready once per process: weighted directions, clusters for visibility, cones for culling."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.color import luminance
from yesnt.relight.envmap import EnvMap, cell_sums, row_solid_angles, texel_directions

F32 = NDArray[np.float32]

BLOCK = 64
"""Texels that share one culling cone: a multiple of every vector width, small enough to cull."""

_EVEN_SHARE = 0.15  # of the split priority: dark sky still occludes the bounce, so it keeps some clusters


@dataclass(frozen=True)
class PreparedLight:
    """Structure of arrays, texels sorted by cluster.

    Attributes:
        direction: [3, T] unit, world; the luminance centroid of each texel.
        energy: [3, T] radiance times solid angle, W/m^2 per channel.
        solid_angle: [T] sr.
        cluster_of: [T] cluster of each texel, ascending.
        cluster_direction: [3, C] unit, world; luminance centroid.
        cluster_energy: [3, C] sum of `energy`.
        cluster_solid_angle: [C] sr.
        cone: [4, ceil(T / BLOCK)] axis and sine of the half angle of each block of texels (1: too wide to cull).
        texel_angle: root mean square angular radius of a texel at the equator, radians.
        env: the map itself.
    """

    direction: F32
    energy: F32
    solid_angle: F32
    cluster_of: NDArray[np.int32]
    cluster_direction: F32
    cluster_energy: F32
    cluster_solid_angle: F32
    cone: F32
    texel_angle: float
    env: EnvMap


def prepare_light(env: EnvMap, texels: int, clusters: int) -> PreparedLight:
    """Downsamples a map to `texels` rows (never above its own) and sorts the texels into `clusters`.

    The sum of `energy` equals the map's to rounding at any resolution. Pure: the same map gives the same bits.
    """
    height = min(texels, env.radiance.shape[0])
    width = min(2 * height, env.radiance.shape[1])
    energy, direction, solid = _cells(env, height, width)
    order, starts = _cluster(energy, direction, solid, clusters)
    energy, direction, solid = (a.reshape(height * width, -1)[order] for a in (energy, direction, solid[..., None]))
    world = direction @ env.world_from_map.T
    weight = _weight(energy, solid[:, 0])
    group = [np.add.reduceat(a, starts[:-1], axis=0) for a in (energy, world * weight[:, None], solid)]
    return PreparedLight(
        direction=_columns(world),
        energy=_columns(energy),
        solid_angle=solid[:, 0].astype(np.float32),
        cluster_of=np.repeat(np.arange(len(starts) - 1), np.diff(starts)).astype(np.int32),
        cluster_direction=_columns(_unit(group[1])),
        cluster_energy=_columns(group[0]),
        cluster_solid_angle=group[2][:, 0].astype(np.float32),
        cone=_cones(world),
        texel_angle=float(np.pi / height / np.sqrt(6.0)),  # a uniform square of side s has radius s / sqrt(6), rms
        env=env,
    )


def _columns(rows: NDArray[np.float64]) -> F32:
    return np.ascontiguousarray(rows.T, dtype=np.float32)


def uniform_light(radiance: float = 1.0) -> EnvMap:
    """The capture light that is assumed when none is given: the same radiance from everywhere."""
    return EnvMap.from_array(np.full((16, 32, 3), radiance, dtype=np.float32))


def _cells(env: EnvMap, height: int, width: int) -> tuple[NDArray[np.float64], ...]:
    """Energy [h, w, 3], centroid direction [h, w, 3] (map axes) and solid angle [h, w] of the cells."""
    fine_h, fine_w = env.radiance.shape[:2]
    solid = np.broadcast_to(row_solid_angles(fine_h, fine_w)[:, None], (fine_h, fine_w))
    directions = texel_directions(fine_h, fine_w)
    energy = env.radiance.astype(np.float64) * env.gain * solid[..., None]
    light = luminance(energy)[..., None]
    amounts = np.concatenate([energy, light * directions, solid[..., None] * directions, solid[..., None]], axis=-1)
    sums = cell_sums(amounts, height, width)
    centre = _unit(sums[..., 6:9])
    length = np.linalg.norm(sums[..., 3:6], axis=-1, keepdims=True)
    centroid = np.where(length > 1e-30, _unit(sums[..., 3:6]), centre)  # a black cell has no centroid of light
    return sums[..., :3], centroid, sums[..., 9]


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    up = np.zeros(vector.shape[-1])
    up[-1] = 1.0
    return np.where(length > 1e-30, vector / np.maximum(length, 1e-30), up)


def _weight(energy: NDArray[np.float64], solid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Importance of texels: luminance plus an even share, so that a black map still spreads its clusters."""
    light = luminance(energy)
    mean = light.sum() / solid.sum()
    return light + (_EVEN_SHARE * mean + 1e-12) * solid


def _cluster(
    energy: NDArray[np.float64], direction: NDArray[np.float64], solid: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Splits the rectangle with the largest weight times angular variance until `count` are left.

    Variance times weight is, to first order, the error of one visibility for the whole rectangle; Debevec's median cut
    (2005) balances weight alone. Returns the texel order and the first position of each cluster [C + 1].
    """
    height, width = solid.shape
    weight = _weight(energy.reshape(-1, 3), solid.reshape(-1)).reshape(height, width)
    moments = np.concatenate([weight[..., None], weight[..., None] * direction], axis=-1)
    table = np.pad(moments.cumsum(0).cumsum(1), ((1, 0), (1, 0), (0, 0)))
    heap = [(-np.inf, (0, height, 0, width))]
    leaves: list[tuple[int, int, int, int]] = []
    while heap and len(heap) + len(leaves) < count:
        _, box = heapq.heappop(heap)
        parts = _split(table, box)
        if len(parts) == 1:
            leaves.append(box)
        for part in parts if len(parts) == 2 else ():
            heapq.heappush(heap, (-_spread(table, part), part))
    boxes = sorted(leaves + [box for _, box in heap], key=lambda b: _morton(b[0] + b[1], b[2] + b[3]))
    index = np.arange(height * width).reshape(height, width)
    members = [index[a:b, c:d].ravel() for a, b, c, d in boxes]
    return np.concatenate(members), np.cumsum([0] + [len(m) for m in members])


def _box_sum(table: NDArray[np.float64], box: tuple[int, int, int, int]) -> NDArray[np.float64]:
    a, b, c, d = box
    return table[b, d] - table[a, d] - table[b, c] + table[a, c]


def _spread(table: NDArray[np.float64], box: tuple[int, int, int, int]) -> float:
    total = _box_sum(table, box)
    if (box[1] - box[0]) * (box[3] - box[2]) == 1:
        return 0.0
    return float(max(total[0] - np.linalg.norm(total[1:]) ** 2 / max(total[0], 1e-30), 1e-12 * total[0]))


def _split(table: NDArray[np.float64], box: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
    """The cut, along rows or columns, that leaves the least spread; one box back if it is a single texel."""
    a, b, c, d = box
    cuts = [[(a, k, c, d), (k, b, c, d)] for k in range(a + 1, b)]
    cuts += [[(a, b, c, k), (a, b, k, d)] for k in range(c + 1, d)]
    if not cuts:
        return [box]
    return min(cuts, key=lambda cut: _spread(table, cut[0]) + _spread(table, cut[1]))


def _morton(row: int, column: int) -> int:
    """Interleaved bits: neighbours in the sphere stay neighbours in memory, so that cones are narrow."""
    code = 0
    for bit in range(16):
        code |= ((row >> bit) & 1) << (2 * bit + 1) | ((column >> bit) & 1) << (2 * bit)
    return code


def _cones(direction: NDArray[np.float64]) -> F32:
    count = -(-len(direction) // BLOCK)
    cones = np.empty((4, count), dtype=np.float32)
    for i in range(count):
        part = direction[i * BLOCK : (i + 1) * BLOCK]
        axis = _unit(part.sum(axis=0))
        cosine = float((part @ axis).min())
        cones[:3, i] = axis
        cones[3, i] = np.sqrt(1 - cosine**2) + 1e-5 if cosine > 0 else 2.0  # 2: never culled
    return cones
