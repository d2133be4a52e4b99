"""Gains of cameras and a smooth factor of the light, found again where they were put in."""

import numpy as np
import pytest

from tests.decompose.evidence.scenes import smooth_light
from yesnt.decompose.evidence.mirrored import occluded_share
from yesnt.decompose.evidence.nuisances import corrected_map, fit_nuisances
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.settings import METALLIC, EvidenceSettings
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
