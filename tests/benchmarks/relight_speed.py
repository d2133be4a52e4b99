"""Speed of relighting, every figure as a ratio measured in one run.

    python tests/benchmarks/relight_speed.py

Prints, per core (processor seconds, so that other work on the machine counts less): pixel-texel pairs a second of the
full sum and its share of the measured multiply-add peak; the same sum in eager torch; the texels of standard quality
against the full sum of 256 x 512, with the error to it, and to it in float64; a frame's time by its matte.
"""

import math
import time
from dataclasses import replace
from functools import partial

import numba
import numpy as np
import torch
from numba import njit, prange

from yesnt.core.color import srgb_encode
from yesnt.relight import Camera, EnvMap, GBuffer, RelightSettings, prepare_light, shade
from yesnt.relight.albedo import albedo_tables
from yesnt.relight.brdf import alpha_ggx, half_vector_terms, smith_visibility
from yesnt.relight.combine import normalise
from yesnt.relight.kernels import METAL_F0, METAL_F90, WIDEN, sum_lobes
from yesnt.relight.points import Pixels
from yesnt.relight.texel_lod import LEAST_COSINE

OPERATIONS = (
    43  # instructions of a pair of the dielectric lobe (lobes._broad), a square root or a division counted as one
)


@njit(parallel=True, fastmath={"contract"}, error_model="numpy")
def _multiply_add(out, rounds):
    for i in prange(out.shape[0]):
        row = out[i]
        for _ in range(rounds):
            for t in range(row.shape[0]):
                x = row[t]
                for _ in range(16):  # stays in registers
                    x = x * np.float32(0.999) + np.float32(0.001)
                row[t] = x


def best(call, times=3, clock=time.process_time):
    call()
    seconds = []
    for _ in range(times):
        started = clock()
        call()
        seconds.append(clock() - started)
    return min(seconds)


def peak():
    """Multiply-adds a second of dependent chains over 1,024 lanes."""
    out = np.ones((8, 1024), np.float32)
    return 8 * 1024 * 16 * 2000 / best(lambda: _multiply_add(out, 2000))


def env(rows=256):
    """Random blocks and one bright texel."""
    rng = np.random.default_rng(0)
    coarse = rng.gamma(0.5, 1.0, (rows // 8, rows // 4, 3)).repeat(8, 0).repeat(8, 1)
    coarse[rows // 4, rows // 2] = 5e3
    return EnvMap.from_array(coarse)


def pixels(count, roughness):
    rng = np.random.default_rng(1)
    unit = lambda a: (a / np.linalg.norm(a, axis=1, keepdims=True)).astype(np.float32)  # noqa: E731
    normal = unit(rng.normal(size=(count, 3)))
    view = unit(normal + 0.9 * unit(rng.normal(size=(count, 3))))
    full = np.ones(count, np.float32)
    return Pixels(np.arange(count), (1, count), 0 * normal, normal, view, full * roughness, 0 * full)


def eager(points, light):
    """The plain formula in eager torch, one texel tile after another, dielectric and diffuse."""
    n, v, a = (torch.from_numpy(np.ascontiguousarray(x)) for x in (points.normal.T, points.viewer.T, points.alpha))
    total = torch.zeros((len(a), 6))
    a2 = (a * a)[:, None]
    for i in range(0, light.texels.direction.shape[1], 128):
        d, e = (
            torch.from_numpy(np.ascontiguousarray(x[:, i : i + 128]))
            for x in (light.texels.direction, light.texels.energy)
        )
        half = torch.nn.functional.normalize(d.T[None] + v[:, None], dim=-1)
        nl, nv = (n @ d).clamp(min=0), (n * v).sum(1, keepdim=True).clamp(min=1e-3)
        nh, vh = (half * n[:, None]).sum(-1), (half * v[:, None]).sum(-1)
        lobe = a2 / (math.pi * (nh * nh * (a2 - 1) + 1) ** 2)
        lobe = lobe * 0.5 / (nv * (nl * nl * (1 - a2) + a2).sqrt() + nl * (nv * nv * (1 - a2) + a2).sqrt())
        lobe = lobe * (0.04 + 0.96 * (1 - vh).clamp(min=0) ** 5) * nl
        total += torch.cat([nl @ e.T, lobe @ e.T], dim=1)
    return total


def full_sum():
    count, light = 16384, prepare_light(env(32), 2048, 16)  # nothing is hidden: few clusters
    lobes = pixels(count, np.float32(0.6)).lobes(slice(0, count), "default")
    ours = best(lambda: sum_lobes(lobes, light, None, None), 10)
    theirs = best(lambda: eager(lobes, light), times=1)
    rate, top = count * 2048 / ours, peak()
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    wall = count * 2048 / best(lambda: sum_lobes(lobes, light, None, None), 10, time.perf_counter)
    numba.set_num_threads(1)
    print(f"full sum on {numba.config.NUMBA_NUM_THREADS} cores: {wall / 1e9:.2f} G pairs/s by the clock")
    share = 100 * rate * OPERATIONS / top
    print(f"full sum: {rate / 1e9:.2f} G pairs/s = {share:.0f} % of {top / 1e9:.0f} G multiply-adds/s")
    print(f"full sum is {theirs / ours:.1f} times faster than eager torch ({theirs:.2f} s for 16,384 x 2,048)")


def reference(px, light):
    """Display colour of a metal of F0 1 in float64: every texel, the lobe averaged over its disc."""
    normal, view = (a.astype(np.float64) for a in (px.normal, px.view))
    direction, energy, solid, spread = (a.astype(np.float64).T for a in np.split(light.texels.level(0), [3, 6, 7]))
    alpha, shown = alpha_ggx(px.roughness.astype(np.float64)), []
    for n, v, a2 in zip(normal, view, alpha * alpha, strict=True):
        cos_o, cos_i = n @ v, np.maximum(direction @ n, 0)
        cos_h, _ = half_vector_terms(n, direction, v)
        disc, slope = WIDEN / max(cos_o, LEAST_COSINE) * spread[:, 0], 1 / np.maximum(cos_h, 1e-9) ** 2 - 1
        x = slope + a2 - disc
        r = np.sqrt(x * x + 4 * a2 * disc)
        lobe = 2 * a2 / (np.pi * r * (r + x)) / np.maximum(cos_h, 1e-9) ** 4
        weight = lobe * smith_visibility(cos_i, cos_o, np.sqrt(a2)) * cos_i
        shown.append(weight @ energy / (weight @ solid[:, 0]))
    tables = albedo_tables()
    white = tables.lookup(tables.white, px.roughness.astype(np.float64), px.cos_o.astype(np.float64))
    return srgb_encode(np.stack(shown) * white[:, None])


def decibels(shown, other):
    return -10 * np.log10(max(np.square(shown - other).mean(), 1e-12))


def standard_against_full():
    count, few = 2048, 192  # float64 is slow: fewer pixels
    fast, full = prepare_light(env(), 2048, 256, rows=256), prepare_light(env(), 131072, 256, rows=256)
    for roughness in (0.0, 0.1, 0.2, 0.3, 0.5, 1.0):
        plain = pixels(count, np.float32(roughness))
        px = replace(plain, metallic=1 + plain.metallic)
        lobes, part = px.lobes(slice(0, count), "default"), slice(0, count)
        calls, shown = [partial(sum_lobes, lobes, light, None, None) for light in (fast, full)], []
        rounds = [[best(call, 2) for call in calls] for _ in range(3)]  # in turns: the machine's speed drifts
        seconds = np.min(rounds, axis=0)
        for light in (fast, full):
            sums = normalise(sum_lobes(lobes, light, None, None), px, part)
            shown.append(srgb_encode(sums[:, METAL_F0] + sums[:, METAL_F90]))
        some = Pixels(px.index[:few], (1, few), *(a[:few] for a in (px.position, px.normal, px.view)),
                      px.roughness[:few], px.metallic[:few])  # fmt: skip
        truth = reference(some, full)
        print(
            f"roughness {roughness}: {seconds[1] / seconds[0]:5.1f} times faster than 256 x 512, "
            f"{decibels(*shown):.1f} dB to it, {decibels(shown[0][:few], truth):.1f} dB to it in float64 "
            f"(the full sum itself {decibels(shown[1][:few], truth):.1f})",
            flush=True,
        )


def matte():
    size = 384
    pose = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3.0], [0, 0, 0, 1]])
    camera = Camera(size, size, size, size, size / 2, size / 2, {1: pose})
    ones = np.ones((size, size), np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (size, size, 1))
    settings, times = RelightSettings.from_quality("standard"), []
    for share in (1.0, 0.05):
        opacity = (np.arange(size * size).reshape(size, size) < share * size * size).astype(np.float32)
        gbuffer = GBuffer(np.full((size, size, 3), 0.5, np.float32), 0.6 * ones, 0 * ones, normal, 3 * ones, opacity)
        times.append(best(lambda g=gbuffer: shade(g, SKY, camera, settings, shadows=False)))
    print(f"5 % matte costs {100 * times[1] / times[0]:.0f} % of a full one ({times[0]:.2f} s)")


SKY = env(64)

if __name__ == "__main__":
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    full_sum()
    standard_against_full()
    matte()
