"""The sun of a map, and a part of a light: what parts give sums up to what the light gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.relight.scenes import sphere, surface
from yesnt.core.color import luminance
from yesnt.relight import EnvMap, RelightSettings, prepare_light
from yesnt.relight.envmap import row_solid_angles
from yesnt.relight.kernels import LIT, sum_lobes
from yesnt.relight.lights import PreparedLight, part_of
from yesnt.relight.occlusion import find_occluders, single_factor
from yesnt.relight.points import gather_pixels
from yesnt.relight.sun import find_sun
from yesnt.scene.light_samples import light_samples

ROWS = 32
SKY = (0.2, 0.4, 0.8)


def sky(**lamps: tuple[slice, slice, float]) -> EnvMap:
    """A blue map with grey lamps: rows, columns (which may be beyond the seam) and radiance."""
    radiance = np.broadcast_to(np.array(SKY, np.float32), (ROWS, 2 * ROWS, 3)).copy()
    for rows, columns, value in lamps.values():
        radiance[rows, np.arange(columns.start, columns.stop) % (2 * ROWS)] = value
    return EnvMap.from_array(radiance)


def power(env: EnvMap) -> float:
    return float((luminance(env.radiance.astype(np.float64)) * row_solid_angles(ROWS, 2 * ROWS)[:, None]).sum())


@pytest.mark.parametrize("column", [0, 20, 2 * ROWS - 1])
def test_the_sun_is_what_a_lamp_gives_beyond_the_sky_behind_it(column: int) -> None:
    env = sky(sun=(slice(8, 10), slice(column - 1, column + 2), 500.0))
    sun = find_sun(env)
    expected = np.maximum(env.radiance - np.array(SKY, np.float32), 0)
    np.testing.assert_allclose(sun.env.radiance, expected, rtol=1e-6)
    assert sun.share == pytest.approx(1 - power(sky()) / power(env), rel=1e-6)
    assert sun.others == 0


def test_of_several_lamps_the_strongest_is_the_sun_and_not_the_brightest() -> None:
    large, bright = (slice(14, 18), slice(10, 14), 100.0), (slice(8, 9), slice(40, 41), 800.0)
    sun = find_sun(sky(large=large, bright=bright))
    assert sun.others == 1
    assert sun.env.radiance[15, 11].all()
    assert not sun.env.radiance[:, 30:].any()


@pytest.mark.parametrize(
    "env",
    [
        sky(),
        EnvMap.from_array(np.zeros((ROWS, 2 * ROWS, 3))),
        sky(window=(slice(8, 24), slice(0, 16), 6.0)),
        sky(glint=(slice(15, 16), slice(3, 4), 10.0)),
    ],
    ids=["sky", "black", "window", "glint"],
)
def test_a_map_without_a_lamp_has_no_sun(env: EnvMap) -> None:
    sun = find_sun(env)
    assert (sun.share, sun.others) == (0, 0)
    assert not sun.env.radiance.any()


def test_exposure_and_rotation_leave_the_sun() -> None:
    env = sky(sun=(slice(8, 10), slice(5, 7), 500.0))
    found = find_sun(env.turned((30, 20, 10), 2))
    assert found.share == find_sun(env).share
    assert (found.env.rotation, found.env.exposure) == ((30, 20, 10), 2)
    np.testing.assert_array_equal(found.env.radiance, find_sun(env).env.radiance)


@pytest.fixture(scope="module", params=[32, 128])
def divided(request: pytest.FixtureRequest) -> tuple[PreparedLight, PreparedLight, PreparedLight]:
    """A light of few clusters or of many, its sun and the rest."""
    env = sky(sun=(slice(8, 10), slice(5, 7), 500.0), lamp=(slice(20, 21), slice(40, 43), 60.0)).turned((40, 10, 0), 1)
    light, sun = prepare_light(env, 512, request.param), find_sun(env).env
    return light, part_of(light, sun), part_of(light, replace(env, radiance=env.radiance - sun.radiance))


def test_parts_of_a_light_sum_up_to_it(divided: tuple[PreparedLight, PreparedLight, PreparedLight]) -> None:
    light, sun, rest = divided
    points = gather_pixels(surface(*sphere(metallic=0.5))).lobes(slice(None), "default")
    whole, one, two = (sum_lobes(points, part, None, None)[:, LIT] for part in divided)
    # A cluster that the horizon cuts is an even square about its own middle: a little is lost in adding two.
    np.testing.assert_allclose(one + two, whole, rtol=1e-3, atol=1e-4 * whole.max())
    assert one.mean() > 0.2 * whole.mean()
    np.testing.assert_allclose(sun.clusters.energy + rest.clusters.energy, light.clusters.energy, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(sun.coarse.energy + rest.coarse.energy, light.coarse.energy, rtol=1e-4, atol=1e-6)
    assert sun.undivided is light
    assert light.undivided is light


def test_parts_share_the_single_shadow_factor_and_the_directions_of_the_set(
    divided: tuple[PreparedLight, PreparedLight, PreparedLight],
) -> None:
    """What is chosen by brightness is chosen by that of the whole light; otherwise parts would not sum up to it."""
    gbuffer, cam = sphere()
    wall = gbuffer.opacity == 0
    z, normal = np.where(wall, 4.2, gbuffer.z), np.where(wall[..., None], np.array([0, -1.0, 0]), gbuffer.normal)
    seen = replace(surface(gbuffer, cam), z=z, normal=normal, opacity=np.ones_like(z))
    settings, pixels = RelightSettings(shadows="single"), gather_pixels(seen)
    occluders = find_occluders(seen, pixels, None, settings)
    whole, *parts = (single_factor(occluders, pixels, slice(0, len(z.ravel())), light, settings) for light in divided)
    assert whole.min() < 0.95
    for part in parts:
        np.testing.assert_array_equal(part, whole)
    samples = [light_samples(light) for light in divided]
    for kind in ("strong", "weak"):
        one, two, three = (getattr(sample, kind) for sample in samples)
        np.testing.assert_array_equal(one.direction, two.direction)
        np.testing.assert_array_equal(one.direction, three.direction)
        np.testing.assert_allclose(two.energy + three.energy, one.energy, rtol=1e-4, atol=1e-7)
