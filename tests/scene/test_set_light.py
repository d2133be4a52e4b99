"""Laws of the light on the set, and the fast way against a sum over every pixel and direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.relight.scenes import box_mesh, sky
from tests.scene.set_scenes import GROUND, box, camera, material, scene, view
from yesnt.relight import brdf as reference
from yesnt.relight.lights import prepare_light, uniform_light
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.scene.light_samples import light_samples
from yesnt.scene.set_brdf import set_brdf
from yesnt.scene.set_kernels import SampleHits, sum_samples
from yesnt.scene.set_light import AGREE, light_set, without_occlusion
from yesnt.scene.set_rays import Met, SetRays, totals
from yesnt.scene.set_view import mesh_image

SETTINGS = RelightSettings()
PAPER = RelightSettings(brdf="paper")


@pytest.fixture(scope="module")
def light():
    return prepare_light(sky(), 128, 64)


@pytest.fixture(scope="module")
def white():
    return prepare_light(uniform_light(), 128, 64)


def reference_lost(seen, light, mesh, color, roughness):
    """Radiance [P, 3] that a black subject takes away: the paper's BRDF over all samples, a ray for each."""
    pixels, lost = seen.pixels, np.zeros((len(seen.pixels.index), 3))
    places = [seen.parts.seen(pixels, part, np.arange(len(lost)))[0] for part in range(4)]
    for samples, edges in ((light_samples(light).strong, True), (light_samples(light).weak, False)):
        for number, (way, energy) in enumerate(zip(samples.direction.T, samples.energy.T, strict=True)):
            if way[2] <= 0:
                continue
            place = places[number % 4] if edges else pixels.position
            origins = (place + 0.002 * pixels.normal).astype(np.float32)
            hidden = mesh.first_hits(origins, np.broadcast_to(way, origins.shape)) != OPEN
            aim = np.broadcast_to(way, origins.shape).astype(np.float64)
            full = np.ones(len(origins))
            parts = reference.evaluate_paper(
                pixels.normal, aim, pixels.view, full[:, None] * color, roughness * full, 0 * full
            )
            lost += hidden[:, None] * sum(parts) * way[2] * energy
    return lost


def test_the_light_taken_away_is_the_sum_over_all_directions(light):
    seen = view(material(0.5, 0.8))
    found = light_set(seen, light, scene(), PAPER)
    expected = reference_lost(seen, light, box(), 0.5, 0.8)
    assert expected.max() > 0.2 * found.open.max(), "the box casts a shadow"
    error = np.abs(np.minimum(expected, found.open) - (found.open - found.blocked))
    assert error.max() < 2 * AGREE * found.open.mean(), "interpolation"
    assert np.sqrt(np.square(error).mean()) < 0.004 * found.open.mean()


def test_without_a_subject_in_the_way_the_set_is_exactly_as_it_is_without_one(light):
    below = box((-0.4, -0.4, -2.0), (0.4, 0.4, -1.0))
    for given in (material(), material(0.9, 0.0, 1.0), material(0.5, 0.2)):
        found = light_set(view(given), light, scene(1.0, below), SETTINGS)
        np.testing.assert_array_equal(found.blocked, found.open)
        assert not found.added.any()


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_white_furnace(white, roughness, metallic):
    """A white set under uniform light, beside a subject that sends out that same light, shows no trace of it."""
    found = light_set(view(material(1.0, roughness, metallic)), white, scene(1.0), SETTINGS)
    np.testing.assert_allclose(found.open, 1, atol=2e-3)
    np.testing.assert_allclose(found.blocked + found.added, 1, atol=0.03)
    assert found.blocked.min() < 0.5, "a black one does"


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.6])
def test_a_shadow_never_brightens_and_light_is_never_negative(light, roughness):
    found = light_set(view(material(0.5, roughness)), light, scene(0.3), SETTINGS)
    assert (found.blocked <= found.open).all()
    assert (found.blocked >= 0).all()
    assert (found.added >= 0).all()
    assert found.added.any()


@pytest.mark.parametrize("roughness", [0.0, 0.8])
def test_linear_in_the_light(light, roughness):
    seen, env = view(material(0.5, roughness)), sky()
    once = light_set(seen, light, scene(), SETTINGS)
    twice = light_set(seen, prepare_light(env.turned((0, 0, 0), 1.0), 128, 64), scene(), SETTINGS)
    np.testing.assert_allclose(twice.blocked, 2 * once.blocked, rtol=1e-4, atol=1e-5)


def test_a_mirror_floor_shows_the_mirrored_scene(light):
    """Where the camera would see the box upside down below the floor it shows the box, elsewhere the mirrored map."""
    cam = camera((48, 64))
    seen = view(material(1.0, 0.0, 1.0), cam)
    found = light_set(seen, light, scene(0.7), SETTINGS)
    upside_down = ProxyScene(box().vertices * np.float32([1, 1, -1]), box().faces)
    shows = []
    for part in seen.parts.rays:
        unit = part / np.linalg.norm(part, axis=1, keepdims=True)
        origins = np.broadcast_to(seen.parts.eye, unit.shape)
        hit = upside_down.first_hits(origins.astype(np.float32), unit.astype(np.float32)) != OPEN
        beside = box().first_hits(origins.astype(np.float32), unit.astype(np.float32)) == OPEN
        shows.append((hit, beside))
    hits = np.array([hit for hit, _ in shows])
    visible = np.all([beside for _, beside in shows], axis=0)  # what the box itself hides does not matter
    inside, outside = hits.all(axis=0) & visible, ~hits.any(axis=0) & visible
    assert inside.sum() > 20
    np.testing.assert_allclose(found.added[inside], 0.7, rtol=0.02)
    np.testing.assert_allclose(found.blocked[inside], 0, atol=1e-5)
    assert not found.added[outside].any()
    expected = np.mean([sky().lookup(part * np.float32([1, 1, -1])) for part in seen.parts.rays], axis=0)
    np.testing.assert_allclose(found.open, expected, rtol=0.02)


def test_the_same_bits_for_any_part_of_the_picture_order_of_rays(light):
    one = light_set(view(), light, scene(0.3), SETTINGS)
    two = light_set(view(), prepare_light(sky(), 128, 64), scene(0.3, replace(box())), SETTINGS)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_contact_is_dark(light, white):
    """Right beside the box half of the sky is gone."""
    seen = view()
    found = light_set(seen, white, scene(), SETTINGS)
    ratio = found.blocked / found.open
    place = seen.pixels.position
    near = (np.abs(place[:, 0]) < 0.3) & (place[:, 1] < -0.41) & (place[:, 1] > -0.55)
    far = np.abs(place[:, 0]) > 2.0
    assert near.any()
    assert ratio[near].max() < 0.75
    assert ratio[far].min() > 0.93


def test_a_sum_over_texels_without_occlusion_is_what_relighting_computes(white):
    seen = view(material(0.18, 1.0))
    free = without_occlusion(seen, np.arange(len(seen.pixels.index)), white, SETTINGS)
    assert GROUND.height == 0
    assert np.all(free[:, :3] < 0.18 + 1e-4)
    assert np.all(free.sum(axis=1) > 3 * 0.18 * 0.9)


@pytest.mark.parametrize(("brdf", "diffuse"), [("default", "lambert"), ("default", "disney"), ("paper", "lambert")])
@pytest.mark.parametrize("sharp", [False, True])
def test_the_compiled_sum_over_rays_is_the_numpy_one(light, brdf, diffuse, sharp):
    seen, rng = view(material([0.7, 0.5, 0.2], 0.35, 0.4)), np.random.default_rng(1)
    samples, count = light_samples(light).weak, 500
    up = np.flatnonzero(samples.direction[2] > 0)
    pixel, sample = np.sort(rng.integers(0, 12, count)), rng.choice(up, count)
    shader = set_brdf(seen.pixels, seen.color, RelightSettings(brdf=brdf, diffuse=diffuse))
    subject, beside = rng.random((2, count)) > 0.5
    sent = rng.random((2, count, 3)).astype(np.float32)
    found, picks = np.zeros((12, 9)), pixel + 40
    hits = SampleHits(pixel, picks, sample, subject, beside, *sent)
    sum_samples(hits, shader, (samples.direction, samples.energy, samples.solid_angle), sharp, found)
    direction = np.ascontiguousarray(samples.direction.T[sample])
    one, two = shader.towards(picks, direction)
    weight = one if sharp else one + two
    before, weight = samples.energy.T[sample] * weight, weight * samples.solid_angle[sample, None]
    expected = totals(12, pixel, before, weight, Met(subject, beside, *sent))
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-6)


def test_beside_the_subject_no_gap_is_lost_between_the_pixels_that_are_looked_at_first(light):
    """Posts of a pixel, two pixels apart: what every pixel's rays find, not the mean of pixels around them."""
    seen = view(material(0.5, 0.8), camera((96, 128)))
    posts = [box_mesh((x, -0.4, 0.0), (x + 0.03, -0.37, 0.1)) for x in np.arange(-0.4, 0.4, 0.09)]
    faces = np.concatenate([f + 8 * i for i, (_, f) in enumerate(posts)])
    given = scene(0.0, ProxyScene.from_arrays(np.concatenate([v for v, _ in posts]), faces))
    rays = SetRays(seen, set_brdf(seen.pixels, seen.color, SETTINGS), given, False)
    every = np.arange(len(seen.pixels.index))
    expected = rays.in_parts(light_samples(light).strong, every) + rays.changes(light_samples(light).weak, every)
    found = light_set(seen, light, given, SETTINGS)
    place = seen.pixels.position
    front = (np.abs(place[:, 0]) < 0.4) & (np.abs(place[:, 1] + 0.4) < 0.06)
    assert front.sum() > 30
    taken = found.open - found.blocked
    np.testing.assert_allclose(taken[front], np.minimum(expected[:, 3:6], found.open)[front], atol=1e-5)


@pytest.mark.parametrize("y", [0.9, 0.95, 1.0, 1.05])
def test_no_part_of_a_pixel_lies_inside_the_mesh_behind_a_crease(y):
    """A wall's plane goes on below the floor that it stands on: a part there would be in the dark."""
    floor, wall = box_mesh((-9, -9, -0.5), (9, 9, 0.0)), box_mesh((-9, y, -0.2), (9, y + 0.2, 2.0))
    faces = np.concatenate([floor[1], wall[1] + 8])
    mesh = ProxyScene.from_arrays(np.concatenate([floor[0], wall[0]]), faces)
    cam = camera((48, 64))
    seen = mesh_image(mesh, material(), cam, 1, np.zeros((48, 64), np.float32)).view
    parts, pixels = seen.parts, seen.pixels
    every = np.arange(len(pixels.index))
    on_wall = pixels.normal[:, 1] < -0.5
    low = [parts.seen(pixels, part, every)[0] for part in range(4)]
    assert on_wall.any()
    assert not on_wall.all()
    assert min(points[on_wall, 2].min() for points in low) > -1e-3
    assert max(points[~on_wall, 1].max() for points in low) < y + 1e-3
    assert not np.array_equal(low[0], low[3]), "elsewhere the parts are apart"
