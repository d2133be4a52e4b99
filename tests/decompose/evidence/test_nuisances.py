"""Gains of cameras and a smooth factor of the light, found again where they were put in."""

import numpy as np
import pytest

from tests.decompose.evidence.scenes import smooth_light
from yesnt.decompose.evidence.mirrored import occluded_share
from yesnt.decompose.evidence.nuisances import corrected_map, fit_nuisances
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.reference import best_base_color, linear_form
from yesnt.decompose.evidence.settings import METALLIC, EvidenceSettings
from yesnt.relight.brdf import alpha_ggx
from yesnt.relight.harmonics import BANDS, TERMS, basis
from yesnt.relight.proxy import OPEN

SETTINGS = EvidenceSettings(independent=2000)
POINTS, VIEWS = 400, 6


def unit(rng, *shape):
    way = rng.normal(size=(*shape, 3))
    return way / np.linalg.norm(way, axis=-1, keepdims=True)


def diffuse_case(light, gain, seed=1):
    """Diffuse surfaces and mirrors of random normals and base colours under uniform light times a factor."""
    rng = np.random.default_rng(seed)
    normal, towards = unit(rng, POINTS), unit(rng, POINTS, VIEWS)
    mirror = 2 * (normal[:, None] * towards).sum(-1, keepdims=True) * normal[:, None] - towards
    metal = (np.arange(POINTS) % 2).astype(bool)
    base = rng.uniform(0.2, 0.9, (POINTS, 1, 3))
    band = (np.array(BANDS) / np.pi)[np.repeat([0, 1, 2], [1, 3, 5])]
    seen = np.where(metal[:, None], basis(mirror) @ light, ((basis(normal) * band) @ light)[:, None])
    radiance = (base * (1 + seen[..., None]) * gain).astype(np.float32)
    one = np.ones((POINTS, VIEWS, 1, 3), np.float32)
    of = Responses(one, 0 * one, one, 0 * one, np.zeros((POINTS, VIEWS, 1), np.float32), np.ones(1, np.float32))
    valid = np.ones((POINTS, VIEWS), bool)
    cost = np.ones((POINTS, 1, len(METALLIC)))
    cost[np.arange(POINTS), 0, np.where(metal, len(METALLIC) - 1, 0)] = 0
    return Observations(radiance, np.float32(0.05) * radiance, valid), of, (normal, towards), (cost, np.array([0.05]))


def test_a_factor_of_the_light_is_found() -> None:
    light = np.array([0, 0.1, -0.2, 0.15, 0, 0.1, -0.1, 0.05, 0.1])
    found = fit_nuisances(*diffuse_case(light, 1.0), SETTINGS)
    np.testing.assert_allclose(found.light[1:], light[1:], atol=0.06)
    assert found.light[0] == 0
    np.testing.assert_allclose(found.gain, 1, atol=0.03)


def test_gains_of_cameras_and_channels_are_found() -> None:
    gain = np.exp(0.06 * np.random.default_rng(4).normal(size=(VIEWS, 3)))
    gain /= np.exp(np.log(gain).mean(axis=0))  # a gain of all cameras is a brighter base colour
    found = fit_nuisances(*diffuse_case(np.zeros(TERMS), gain), SETTINGS)
    np.testing.assert_allclose(found.gain, gain, atol=0.015)
    assert np.abs(found.light).max() < 0.05


def test_what_is_right_is_left_alone_and_nothing_is_fitted_with_an_error_of_0() -> None:
    found = fit_nuisances(*diffuse_case(np.zeros(TERMS), 1.0), SETTINGS)
    np.testing.assert_allclose(found.gain, 1, atol=2e-3)
    np.testing.assert_allclose(found.light, 0, atol=5e-3)
    spoilt = diffuse_case(np.r_[0, 0.2 * np.ones(8)], np.linspace(0.9, 1.1, VIEWS)[:, None])
    still = fit_nuisances(*spoilt, EvidenceSettings(gain_error=0, light_error=0))
    np.testing.assert_allclose(still.gain, 1, atol=1e-3)
    np.testing.assert_allclose(still.light, 0, atol=1e-3)


def noisy(case, seed):
    """The same with noise of one standard deviation of the observations."""
    seen, *others = case
    noise = np.random.default_rng(seed).normal(size=seen.radiance.shape)
    return seen._replace(radiance=(seen.radiance + seen.sigma * noise).astype(np.float32)), *others


@pytest.mark.parametrize("seed", range(3))
def test_noise_moves_neither_a_true_light_nor_true_gains(seed: int) -> None:
    found = fit_nuisances(*noisy(diffuse_case(np.zeros(TERMS), 1.0), seed), SETTINGS)
    assert np.abs(found.gain - 1).max() < 0.01
    assert np.abs(found.light).max() < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_is_brighter_by_5_percent_is_mended_through_noise(seed: int) -> None:
    gain = np.ones((VIEWS, 1))
    gain[2] = 1.05
    found = fit_nuisances(*noisy(diffuse_case(np.zeros(TERMS), gain), seed), SETTINGS).gain
    left = gain / found
    assert np.abs(left / left.mean(axis=0) - 1).max() < 0.02
    assert (found[2] / np.delete(found, 2, axis=0).mean(axis=0) > 1.025).all()


def test_points_that_no_camera_sees_tell_nothing() -> None:
    seen, *others = diffuse_case(np.r_[0, 0.2 * np.ones(8)], 1.0)
    found = fit_nuisances(seen._replace(valid=np.zeros_like(seen.valid)), *others, SETTINGS)
    assert (found.gain == 1).all()
    assert not found.light.any()


def test_the_corrected_map_is_the_map_times_its_factor_in_the_world() -> None:
    env = smooth_light().turned((40, 0, 0), 0.5)
    light = np.array([0, 0.1, -0.2, 0.15, 0, 0.1, -0.1, 0.05, 0.1])
    way = unit(np.random.default_rng(2), 50)
    found, before = (one.lookup(way.astype(np.float32)) for one in (corrected_map(env, light), env))
    np.testing.assert_allclose(found / before, np.repeat((1 + basis(way) @ light)[:, None], 3, axis=1), rtol=0.02)
    np.testing.assert_array_equal(corrected_map(env, np.zeros(TERMS)).radiance, env.radiance)


@pytest.mark.parametrize(("blocked", "share"), [("mirror", 1), ("other", 0)])
def test_the_share_of_the_subject_is_what_stands_where_the_view_is_mirrored_to(blocked: str, share: int) -> None:
    normal, towards = np.float32([[0, 0, 1]]), np.float32([[0.6, 0, 0.8]])
    direction = np.ascontiguousarray(np.float32([[-0.6, 0, 0.8], [0.6, 0, 0.8], [0, 0, 1]]).T)
    hits = np.full((1, 3), OPEN, np.int32)
    hits[0, 0 if blocked == "mirror" else 1] = 7
    found = occluded_share(normal, towards, hits, (direction, np.ones(3, np.float32)), SETTINGS.sharpness)
    np.testing.assert_allclose(found, share, atol=1e-3)


def test_the_share_of_the_subject_is_the_sum_over_the_clusters() -> None:
    """Plain NumPy: the lobe exp(sharpness (w.l - 1)) about the mirrored view w, over all clusters and the occluded."""
    rng = np.random.default_rng(5)
    normal, towards = unit(rng, 30).astype(np.float32), unit(rng, 30).astype(np.float32)
    direction = unit(rng, 40).astype(np.float32)
    solid, hits = rng.uniform(0.1, 1, 40).astype(np.float32), rng.integers(-1, 2, (30, 40)).astype(np.int32)
    mirror = 2 * (normal * towards).sum(1, keepdims=True) * normal - towards
    lobe = solid * np.exp(20.0 * (mirror @ direction.T - 1))
    expected = (lobe * (hits != OPEN)).sum(axis=1) / lobe.sum(axis=1)
    found = occluded_share(normal, towards, hits, (np.ascontiguousarray(direction.T), solid), 20.0)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_projecting_the_base_colours_out_is_solving_for_all_unknowns_at_once() -> None:
    """Least squares with a column for the base colour of every point and channel gives the same gains and light."""
    light, gain = np.array([0, 0.1, -0.2, 0.15, 0, 0.1, -0.1, 0.05, 0.1]), np.full((VIEWS, 3), 1.03)
    gain[::2] = 0.98
    seen, of, (normal, towards), (cost, levels) = diffuse_case(light, gain)
    few = slice(0, 40)
    seen = Observations(*(a[few] for a in seen))
    of = of._replace(**{n: getattr(of, n)[few] for n in ("diffuse", "dielectric", "metal_f0", "metal_f90", "missing")})
    found = fit_nuisances(seen, of, (normal[few], towards[few]), (cost[few], levels), SETTINGS)
    matrix, right = np.zeros((8 + 3 * VIEWS + 120,) * 2), np.zeros(8 + 3 * VIEWS + 120)
    spread = SETTINGS.light_error * np.sqrt(4 * np.pi / 8)
    np.fill_diagonal(matrix[:8, :8], 1 / spread**2)
    np.fill_diagonal(matrix[8 : 8 + 3 * VIEWS, 8 : 8 + 3 * VIEWS], 1 / SETTINGS.gain_error**2)
    band = np.repeat([0, 1, 2], [1, 3, 5])
    alpha = alpha_ggx(np.array(levels[0]))
    for p in range(40):
        metal = p % 2
        one = Observations(*(a[p : p + 1] for a in seen))
        lobes = of._replace(**{n: getattr(of, n)[p : p + 1] for n in of._fields if n != "average"})
        base = best_base_color(one, lobes, SETTINGS, 0, float(metal))
        slope, offset = linear_form(lobes, base, 0, float(metal))
        for v in range(VIEWS):
            mirror = 2 * (normal[p] @ towards[p, v]) * normal[p] - towards[p, v]
            blurred = basis(mirror) * np.exp(-(alpha**2) * band * (band + 1))
            lit = blurred if metal else basis(normal[p]) * (np.array(BANDS) / BANDS[0])[band]
            for k in range(3):
                expected = base[0, k] * slope[0, v, k] + offset[0, v, k]
                error = (seen.radiance[p, v, k] - expected) / seen.sigma[p, v, k]
                weight = (SETTINGS.freedom + 1) / (SETTINGS.freedom + error**2) / float(seen.sigma[p, v, k]) ** 2
                row = np.zeros(len(right))
                row[:8], row[8 + k * VIEWS + v] = expected * lit[1:], expected
                row[8 + 3 * VIEWS + 3 * p + k] = slope[0, v, k]
                matrix += weight * np.outer(row, row)
                right += weight * row * (seen.radiance[p, v, k] - expected)
    whole = np.linalg.lstsq(matrix, right, rcond=None)[0]
    np.testing.assert_allclose(found.light[1:], whole[:8], atol=2e-4)
    np.testing.assert_allclose(found.gain, np.exp(whole[8 : 8 + 3 * VIEWS].reshape(3, VIEWS).T), atol=2e-4)
