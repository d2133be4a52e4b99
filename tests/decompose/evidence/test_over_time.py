"""One camera over time: a painted sphere that turns, and the tracks of pixels."""

from functools import cache

import numpy as np
import pytest

from tests.decompose.evidence.scenes import FRAME, RELIGHT, look_from, picture, proxy, smooth_light
from yesnt.decompose.evidence.frame import EvidenceInputs
from yesnt.decompose.evidence.over_time import Moment, measure_over_time
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.evidence.tracks import earlier_places, later_places
from yesnt.decompose.reuse import Link
from yesnt.relight import EnvMap, Surface
from yesnt.relight.frame import prepare_capture

SIZE = 20
COLUMNS = 48
SETTINGS = EvidenceSettings()
STEPS = (-10, -7, -4, 4, 7, 10)
"""Turns of the sphere in columns of the map, 7.5 degrees each."""


@cache
def turned(step):
    """The sphere turned about Z, as seen from itself: camera and light turn the other way round it."""
    angle = 2 * np.pi * step / COLUMNS
    way = np.array([np.sin(angle), -np.cos(angle), 0.05])
    camera = look_from(way, SIZE)
    env = EnvMap.from_array(np.roll(smooth_light(0.9).radiance, -step, axis=1))
    color, matte, normal, z, painted = picture(camera, env)
    full = np.ones(matte.shape, np.float32)
    surface = Surface(normal, z, matte, 0.5 * full, 0.3 * full, camera, FRAME)
    spread = np.stack([0.1 * full, 0.1 * full])
    return EvidenceInputs(color, surface, spread, [], proxy(), prepare_capture(env, RELIGHT)), painted


def moments(steps):
    """Other turns, with the place of every pixel that they show too."""
    surface = turned(0)[0].surface
    found = []
    for step in steps:
        other = turned(step)[0]
        camera = other.surface.camera
        x, y, _ = np.moveaxis(camera.project(surface.normal.reshape(-1, 3), FRAME), -1, 0)
        shown = (surface.normal.reshape(-1, 3) @ camera.position(FRAME)) > 1.2  # of a unit sphere
        place = np.where(shown[:, None], np.stack([x, y], axis=-1) - 0.5, np.nan)
        found.append(Moment(other, place.reshape(SIZE, SIZE, 2).astype(np.float32)))
    return found


def errors(found):
    given, painted = turned(0)
    inside = given.surface.opacity > 0.5
    pair = zip(found.mean, (painted.roughness, painted.metallic), strict=True)
    return np.array([np.sqrt(np.square(a[inside] - b[inside]).mean()) for a, b in pair]), inside


def test_a_map_that_turns_about_the_subject_is_the_subject_turning() -> None:
    """The law that this file stands on: the light at a point turned with its map is the same."""
    env, step = smooth_light(0.9), 5
    other = EnvMap.from_array(np.roll(env.radiance, -step, axis=1))
    way = np.array([[0.3, -0.8, 0.2], [-0.5, -0.1, -0.7]])
    angle = 2 * np.pi * step / COLUMNS
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    there = (way @ turn.T).astype(np.float32)
    np.testing.assert_allclose(other.lookup(there), env.lookup(way.astype(np.float32)), rtol=1e-3)


def test_a_subject_that_turns_is_measured_by_one_camera() -> None:
    given, painted = turned(0)
    found, inside = errors(measure_over_time(given, moments(STEPS), RELIGHT, SETTINGS))
    guess = [np.sqrt(np.square(a - b[inside]).mean()) for a, b in ((0.5, painted.roughness), (0.3, painted.metallic))]
    assert found[0] < 0.75 * guess[0]
    assert found[1] < 0.6 * guess[1]


def test_where_tracks_are_lost_the_model_stands() -> None:
    given, _ = turned(0)
    lost = [Moment(one.inputs, np.where(np.arange(SIZE)[:, None] < 10, one.place, np.nan)) for one in moments((-7, 7))]
    found = measure_over_time(given, lost, RELIGHT, SETTINGS)
    np.testing.assert_array_equal(found.mean[0][:, 10:], given.surface.roughness[:, 10:])
    np.testing.assert_array_equal(found.std[:, :, 10:], given.spread[:, :, 10:])
    assert not found.views[:, 10:].any()
    assert found.views[:, :10].max() == 3, "the frame itself and two others"


def test_it_does_not_depend_on_tiles() -> None:
    given, _ = turned(0)
    whole, tiled = (
        measure_over_time(given, moments((-7, 7)), RELIGHT, EvidenceSettings(tile=tile)) for tile in (4096, 64)
    )
    np.testing.assert_array_equal(whole.mean, tiled.mean)
    np.testing.assert_array_equal(whole.std, tiled.std)


def shifted(dx, dy, count=1, shape=(12, 16)):
    """Links of a subject that moves by whole pixels each frame, and its mattes."""
    mattes = [np.zeros(shape, bool) for _ in range(count + 1)]
    for i, matte in enumerate(mattes):
        matte[3 + i * dy : 8 + i * dy, 2 + i * dx : 9 + i * dx] = True
    flow = np.broadcast_to(np.float32([dx, dy]), (*shape, 2)).copy()
    return [Link(flow, matte.astype(np.float32)) for matte in mattes[:-1]], mattes


def test_tracks_add_the_flow_and_back_they_lead_where_they_came_from() -> None:
    links, mattes = shifted(2, 1, count=3)
    there = later_places(links, mattes)
    assert there[4, 5].tolist() == [5 + 6, 4 + 3]
    assert np.isnan(there[~mattes[0]]).all()
    assert np.isfinite(there[mattes[0]]).all()
    back = earlier_places(links, mattes)
    assert back[7, 11].tolist() == [5, 4]
    assert np.isfinite(back[mattes[-1]]).all()
    assert np.isnan(back[~mattes[-1]]).all()


def test_a_track_is_lost_where_the_flow_is_not_valid_and_parts_of_a_pixel_are_kept() -> None:
    links, mattes = shifted(0, 0)
    links[0].validity[4, 4] = 0.3
    links[0].flow[...] = 0.25, -0.25
    there, back = later_places(links, mattes), earlier_places(links, mattes)
    assert np.isnan(there[4, 4]).all()
    assert np.isnan(back[4, 4]).all()
    assert there[5, 5].tolist() == [5.25, 4.75]
    assert back[5, 5].tolist() == [4.75, 5.25]


def test_of_two_tracks_that_meet_the_nearer_counts() -> None:
    links, mattes = shifted(0, 0)
    links[0].flow[5, 4] = 1.2, 0  # lands beside (5, 5), which itself lands on it
    assert earlier_places(links, mattes)[5, 5].tolist() == [5, 5]
    links[0].flow[5, 5] = 0.4, 0
    assert earlier_places(links, mattes)[5, 5].tolist() == pytest.approx([3.8, 5])
