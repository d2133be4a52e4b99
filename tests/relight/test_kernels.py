from dataclasses import replace

import numba
import numpy as np
import pytest

from tests.relight.scenes import sky
from yesnt.relight import EnvMap, prepare_light
from yesnt.relight.brdf import disney_diffuse, evaluate_paper
from yesnt.relight.combine import normalise, response
from yesnt.relight.kernels import IRRADIANCE, LIT, METAL_F0, METAL_F90, OPEN_LIGHT, sum_lobes
from yesnt.relight.points import Pixels


def pixels(roughness, metallic=1.0, count=300, spread=0.9, seed=0):
    rng = np.random.default_rng(seed)
    unit = lambda a: (a / np.linalg.norm(a, axis=1, keepdims=True)).astype(np.float32)  # noqa: E731
    normal = unit(rng.normal(size=(count, 3)))
    view = unit(normal + spread * unit(rng.normal(size=(count, 3))))
    full = np.ones(count, np.float32)
    return Pixels(np.arange(count), (1, count), 0 * normal, normal, view, full * roughness, full * metallic)


def integrate(px, light, brdf="default"):
    everything = slice(0, len(px.index))
    sums = sum_lobes(px.lobes(everything, brdf), light, None, None, filtered=brdf != "paper")
    return sums if brdf == "paper" else normalise(sums, px, everything)


@pytest.mark.parametrize("roughness", [0.05, 0.1, 0.3, 0.6, 1.0])
def test_full_sum_equals_the_float64_reference(roughness):
    light, px = prepare_light(sky(32), 2048, 64), pixels(np.float32(roughness))
    sums = integrate(px, light, "paper")
    wide = [a.astype(np.float64) for a in (px.normal, px.view, light.texels.direction.T, light.texels.energy.T)]
    normal, view, direction = (a / np.linalg.norm(a, axis=1, keepdims=True) for a in wide[:3])
    energy = wide[3]
    args = (normal[:, None], direction[None], view[:, None], np.full((300, 1, 3), 0.7))
    diffuse, specular = evaluate_paper(*args, px.roughness[:, None].astype(float), np.full((300, 1), 0.5))
    facing = np.maximum(normal @ direction.T, 0)
    truth = [np.einsum("ptc,pt,tc->pc", f, facing, energy) for f in (diffuse, specular)]
    f0 = 0.04 * 0.5 + 0.7 * 0.5
    found = [0.5 * 0.7 / np.pi * sums[:, IRRADIANCE], f0 * sums[:, METAL_F0] + sums[:, METAL_F90]]
    seen = (normal * view).sum(1) > 0.05
    limit = 2e-3 if roughness <= 0.1 else 1e-3
    for a, b in zip(found, truth, strict=True):
        assert np.percentile(np.abs(a - b)[seen] / b[seen], 99.9) < limit


@pytest.mark.parametrize("texels", [128, 2048])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_white_furnace(metallic, texels):
    light = prepare_light(EnvMap.from_array(np.ones((64, 128, 3))), texels, 64)
    for roughness in (0.0, 0.05, 0.2, 0.5, 1.0):
        px = pixels(np.float32(roughness), np.float32(metallic))
        white = np.ones((300, 3), np.float32)
        weights = response(integrate(px, light), px, "default")
        assert np.allclose(white * weights.diffuse + weights.specular(white), 1, atol=0.01)


def test_without_compensation_a_white_metal_never_exceeds_one():
    light = prepare_light(EnvMap.from_array(np.ones((64, 128, 3))), 10**5, 64)
    for roughness in (0.3, 0.5, 0.8, 1.0):
        px = pixels(np.float32(roughness))
        weights = response(integrate(px, light, "paper"), px, "paper")
        assert weights.specular(np.ones((300, 3), np.float32)).max() < 1.003  # quadrature


def test_bits_do_not_depend_on_threads():
    light, px = prepare_light(sky(32), 1024, 64), pixels(np.float32(0.3))
    before = numba.get_num_threads()
    results = []
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        results.append(integrate(px, light).tobytes())
    numba.set_num_threads(before)
    assert len(set(results)) == 1


def test_map_normal_and_view_turned_together_change_nothing():
    env, angles = sky(32), (25, -40, 70)
    turned = env.turned(angles)
    matrix = turned.world_from_map.astype(np.float32)
    px = pixels(np.float32(0.4))
    moved = Pixels(px.index, px.shape, px.position, px.normal @ matrix.T, px.view @ matrix.T, px.roughness, px.metallic)
    one, two = integrate(px, prepare_light(env, 1024, 64)), integrate(moved, prepare_light(turned, 1024, 64))
    scale = np.abs(one).max(0)
    assert (np.abs(one - two) / np.maximum(scale, 1e-6)).max() < 1e-5


def test_what_is_hidden_is_replaced_by_what_bounces():
    light, px = prepare_light(sky(32), 512, 32), pixels(np.float32(0.6))
    lobes = px.lobes(slice(0, 300), "default")
    whole = sum_lobes(lobes, light, None, None)
    nothing = np.zeros((300, len(light.clusters)), bool)
    assert np.array_equal(sum_lobes(lobes, light, nothing, None), whole)
    dark = sum_lobes(lobes, light, ~nothing, None)
    assert (dark[:, LIT] == 0).all()
    open_ = dark[:, OPEN_LIGHT].mean(0), whole[:, OPEN_LIGHT].mean(0)
    assert np.allclose(*open_, rtol=0.05)  # what would arrive in the open stays
    indirect = np.full((3, 300, len(light.clusters)), 0.5, np.float32)
    lit = sum_lobes(lobes, light, ~nothing, indirect)
    assert np.allclose(lit[:, [0, 6, 9]], 0.5 * lit[:, [16, 18, 19]], rtol=1e-4)


def test_light_is_what_is_seen_plus_what_is_hidden():
    light, px = prepare_light(sky(32), 512, 32), pixels(np.float32(0.6))
    lobes = px.lobes(slice(0, 300), "default")
    hidden = np.random.default_rng(0).random((300, len(light.clusters))) < 0.4
    parts = [sum_lobes(lobes, light, mask, None)[:, LIT] for mask in (hidden, ~hidden)]
    assert np.allclose(parts[0] + parts[1], sum_lobes(lobes, light, None, None)[:, LIT], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("roughness", [0.2, 0.3, 0.4, 0.6, 1.0])
def test_the_tree_of_standard_quality_is_within_40_db_of_the_full_sum(roughness):
    env = sky(64)
    full, fast = (integrate(pixels(np.float32(roughness)), prepare_light(env, n, 256)) for n in (8192, 2048))
    for columns in (IRRADIANCE, METAL_F0):
        a, b = full[:, columns], fast[:, columns]
        assert -10 * np.log10(np.mean(np.square(a - b)) / np.square(a).max()) > 40


@pytest.mark.parametrize("roughness", [0.1, 0.6, 1.0])
def test_disney_diffuse_equals_the_float64_reference(roughness):
    light, px = prepare_light(sky(32), 2048, 64), pixels(np.float32(roughness), 0.0)
    sums = sum_lobes(px.lobes(slice(0, 300), "default", "disney"), light, None, None)
    direction, energy = light.texels.direction.T.astype(float), light.texels.energy.T.astype(float)
    facing, cos_o = np.maximum(px.normal @ direction.T, 0), px.cos_o[:, None].astype(float)
    cos_d = np.sqrt(np.clip(0.5 * (1 + px.view @ direction.T), 0, 1))
    truth = (disney_diffuse(facing, cos_o, cos_d, np.float64(roughness)) * facing) @ energy
    assert np.allclose(sums[:, IRRADIANCE], truth, rtol=1e-3)


def test_light_from_straight_behind_what_is_seen_is_finite():
    """There |l + v|^2 is 0 and may round to below it."""
    light, rng = prepare_light(sky(32), 2048, 64), np.random.default_rng(3)
    direction = light.texels.direction.T
    view = -direction[rng.integers(0, len(direction), 20000)]
    view = (view / np.linalg.norm(view, axis=1, keepdims=True)).astype(np.float32)
    aside = np.cross(view, rng.normal(size=view.shape))
    normal = 0.35 * view + aside / np.linalg.norm(aside, axis=1, keepdims=True)
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    for metallic in (0.0, 1.0):
        px = pixels(np.float32(0.67), np.float32(metallic), len(view))
        sums = integrate(replace(px, normal=normal, view=view), light)
        assert np.isfinite(sums).all()
        assert (sums >= 0).all()
