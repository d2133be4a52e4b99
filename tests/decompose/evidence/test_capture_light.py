"""The capture light from all cameras: a painted sphere under lights that are known."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.decompose.evidence.scenes import PAINT, around, inputs, smooth_light
from yesnt.decompose.evidence import capture_light
from yesnt.decompose.evidence.capture_light import (
    LitFaces,
    estimate_light,
    fit_harmonics,
    lit_faces,
    same_albedo,
    transfer_of,
)
from yesnt.decompose.evidence.observe import prepare_view
from yesnt.decompose.evidence.records import View
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight import EnvMap, ProxyScene
from yesnt.relight.harmonics import BANDS, basis

SETTINGS = EvidenceSettings()
MATT = tuple((0.85, 0.0, base) for _, _, base in PAINT)
SMOOTH, EVEN = smooth_light(), EnvMap.from_array(np.ones((8, 16, 3)))
SPHERE = np.random.default_rng(0).normal(size=(4000, 3))
SPHERE /= np.linalg.norm(SPHERE, axis=1, keepdims=True)


@pytest.fixture(autouse=True)
def few_pairs(monkeypatch):
    """A sphere needs no more."""
    monkeypatch.setattr(capture_light, "PAIRS", 8000)
    monkeypatch.setattr(capture_light, "FACES", 1500)


@cache
def captured(strength=0.8, bands=MATT):
    """Cameras all around the sphere, the plate among them, with what they show of the proxy; and the proxy."""
    given, _ = inputs(np.concatenate([around(6), -around(6)]), smooth_light(strength), 20, bands)
    plate = View("plate", given.surface.camera, given.surface.frame, given.plate, given.surface.opacity)
    return [prepare_view(view, given.proxy, SETTINGS) for view in (plate, *given.views)], given.proxy


def relative(env):
    """Radiance [N, 3] in directions all over the sphere, of mean 1."""
    found = env.lookup(SPHERE.astype(np.float32))
    return found / found.mean(axis=0)


def apart(one, other):
    return float(np.sqrt(np.square(relative(one) - relative(other)).mean()))


def test_a_smooth_light_is_found_and_an_even_one_stays_even() -> None:
    assert apart(estimate_light([captured()], SETTINGS), SMOOTH) < 0.5 * apart(EVEN, SMOOTH)
    assert apart(estimate_light([captured(0.0)], SETTINGS), EVEN) < 0.04


def test_metal_bands_do_not_lead_it_astray() -> None:
    assert apart(estimate_light([captured(bands=PAINT)], SETTINGS), SMOOTH) < 0.75 * apart(EVEN, SMOOTH)


def test_brighter_pictures_in_a_channel_give_the_same_light_of_mean_1() -> None:
    views, proxy = captured()
    tinted = [replace(seen, radiance=seen.radiance * np.float32([3.0, 1.0, 0.5])) for seen in views]
    one, other = (estimate_light([(seen, proxy)], SETTINGS) for seen in (views, tinted))
    np.testing.assert_allclose(other.lookup(SPHERE.astype(np.float32)).mean(axis=0), 1, atol=0.02)
    assert apart(one, other) < 0.02


def test_without_a_view_or_a_point_it_is_uniform() -> None:
    views, proxy = captured()
    for frames in ([], [(views[:1], proxy)]):
        assert np.allclose(estimate_light(frames, SETTINGS).radiance, 1), "one camera does not tell highlights"


def test_the_transfer_of_a_convex_body_is_that_of_funk_and_hecke() -> None:
    faces = lit_faces(*captured(), SETTINGS)
    assert len(faces.color) > 400
    assert not faces.received.any()
    level = faces.transfer[:, 0]
    np.testing.assert_allclose(level, BANDS[0] * basis(SPHERE)[0, 0], rtol=0.03)
    # Irradiance by a harmonic is the harmonic of the normal, which the transfer's own band 1 tells.
    normal = faces.transfer[:, [3, 1, 2]] / (BANDS[1] * np.sqrt(3 / (4 * np.pi)))
    expected = basis(normal) * np.repeat(BANDS, [1, 3, 5])
    np.testing.assert_allclose(faces.transfer, expected, atol=0.04)


def test_what_is_occluded_is_taken_from_the_light_and_comes_from_the_subject() -> None:
    """A wall beside a floor: at its foot half of the sky is hidden, and the wall sends its own radiance."""
    floor = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    wall = [[0.4, -1, 0], [0.4, 1, 0], [0.4, 1, 9], [0.4, -1, 9]]
    scene = ProxyScene.from_arrays(floor + wall, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    shown = np.float32([[0] * 3, [0] * 3, [2] * 3, [2] * 3, [0] * 3])
    at, up = np.float32([[0.35, 0, 0]]), np.float32([[0, 0, 1]])
    transfer, received = transfer_of(scene, at, up, shown)
    level = transfer[0, 0] / basis(up)[0, 0]
    assert level == pytest.approx(np.pi / 2, rel=0.1)
    assert received[0, 0] == pytest.approx(2 * (np.pi - level), rel=0.1)


def test_pairs_of_other_colours_and_of_other_albedo_tell_nothing() -> None:
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(400, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    transfer = basis(normal) * np.repeat(BANDS, [1, 3, 5])
    true = np.zeros((9, 3))
    true[0], true[2] = 2 * np.sqrt(np.pi), 0.5
    albedo = np.where(rng.random(400) < 0.2, 0.2, 0.6)  # a fifth is darker paint of the same hue
    color = albedo[:, None] * (transfer @ true)
    faces = LitFaces(color, transfer, np.zeros((400, 3)), np.ones(400))
    found = fit_harmonics([faces], [same_albedo(faces)], 0)
    assert found[1] == pytest.approx(0.5, rel=0.15)
    assert np.abs(np.delete(found, 1)).max() < 0.1
    red = replace(faces, color=color * np.where(np.arange(400)[:, None] % 2, 1, [1.0, 0.5, 0.5]))
    first, second = same_albedo(red)
    assert (first % 2 == second % 2).all()
