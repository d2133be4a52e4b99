"""What the set sees of the subject: colours of sides that the delivered camera does not see, and their bounces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from tests.relight.scenes import sky
from tests.scene import ball
from tests.scene.set_scenes import GROUND, box, material, view
from yesnt.relight.envmap import EnvMap
from yesnt.relight.frame import FrameInputs, relight_frame
from yesnt.relight.indirect import PixelRays
from yesnt.relight.lights import PreparedLight, prepare_light
from yesnt.relight.occlusion import lifted
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import Brdf, RelightSettings
from yesnt.relight.surroundings import Surroundings
from yesnt.scene.contact import subject_edge
from yesnt.scene.delivered_picture import DeliveredPicture, hits_of
from yesnt.scene.pixel_parts import RayGrid
from yesnt.scene.set_frame import inner_pixels
from yesnt.scene.subject_materials import SubjectMaterials


def test_edge_pixels_colour_nothing_unless_there_are_only_edges() -> None:
    shown, opacity = np.array([3, 4, -1, 5], np.int32), np.array([1, 0.3, 1, 0.95], np.float32)
    np.testing.assert_array_equal(inner_pixels(shown, opacity), [3, -1, -1, 5])
    np.testing.assert_array_equal(inner_pixels(shown, opacity * 0.5), shown)


def test_a_wide_open_ground_does_not_hide_what_a_bounce_is_worth_to_the_subject() -> None:
    light = prepare_light(sky(), 128, 64)
    raised = box((-0.05, -0.05, 0.01), (0.05, 0.05, 0.1))
    own, ground = len(raised.faces), ProxyScene.from_arrays(*GROUND.mesh())
    scene = Surroundings(ground, material()).around(raised)
    albedo = np.full((len(scene.faces), 3), 0.5, np.float32)

    def received(first: int | None) -> NDArray[np.float32]:
        return scene.gather(light.coarse, albedo, 2, 0.002, 0.03, first=first)[0][:own]

    once, twice = (scene.gather(light.coarse, albedo, n, 0.002)[0][:own] for n in (1, 2))
    assert np.abs(twice - once).max() > 0, "the ground sends light up"
    np.testing.assert_array_equal(received(None), once)
    np.testing.assert_array_equal(received(own), twice)


EVERY = RelightSettings(rays="every", edges=False, pixel_filter=0.0, error=0.0, clusters=128)


@pytest.fixture(scope="module")
def light() -> PreparedLight:
    return prepare_light(sky(), 256, 128)


@pytest.mark.parametrize(("brdf", "metallic"), [("default", 0.0), ("paper", 0.5), ("paper", 1.0)])
def test_a_mirror_shows_the_subject_relit_as_seen_from_there(light: PreparedLight, brdf: Brdf, metallic: float) -> None:
    """Rays from a camera at the side meet what relighting shows that camera, highlights and unseen sides included.

    The default widens a metal's lobe by the turn of the normals between pixels; a mirror has four rays in each instead.
    """
    settings = replace(EVERY, brdf=brdf)
    front, side = ball.camera((0, -4, 1), 96), ball.camera((3.5, -1.5, 0.4))
    subject = ball.relit(ball.surface(front, 0.3, metallic)).around(light, ball.ground(), settings)
    hits, known = hits_of(subject.mesh, *ball.rays(side))
    grid = RayGrid(known.astype(np.int64), (24, 24), np.full(len(known), 0.02, np.float32))
    turned = np.arange(len(known))[::-1]
    found = subject.mirrored(hits.taken(turned), RayGrid(grid.place[turned], grid.shape, grid.footprint))[::-1]
    seen = ball.surface(side, 0.3, metallic)
    base = np.broadcast_to(ball.BASE, (24, 24, 3))
    frame = relight_frame(FrameInputs(base, seen, base), light, None, ball.mesh(), settings, ball.ground())
    expected = frame.radiance.reshape(-1, 3)[known]
    assert not subject.picture.read(subject.diffuse, hits)[1].all(), "the delivered view does not show all of it"
    assert np.sqrt(np.square(found - expected).mean()) < 0.03 * expected.mean()


def test_a_side_that_no_pixel_shows_takes_the_materials_of_the_nearest_vertices_and_the_normals_of_the_mesh() -> None:
    front, back = ball.camera((0, -4, 1)), ball.camera((0, 4, 1))
    seen = ball.surface(front, 0.3, 1.0)
    base = np.broadcast_to(ball.BASE, (24, 24, 3)).copy()
    edge = np.asarray(seen.opacity).copy()
    rim = (edge > 0) & ~binary_erosion(edge > 0)
    base[rim], edge[rim] = 0, 0.6  # an edge pixel, whose colour is partly the background's
    materials = SubjectMaterials(DeliveredPicture(ball.mesh(), replace(seen, opacity=edge)), base)
    hits, _ = hits_of(ball.mesh(), *ball.rays(back))
    found = materials.at(hits)
    np.testing.assert_allclose(found.base, np.broadcast_to(ball.BASE, found.base.shape), atol=1e-5)
    np.testing.assert_allclose(found.roughness, 0.3, atol=1e-5)
    np.testing.assert_allclose(found.metallic, 1, atol=1e-5)
    outwards = (hits.point - np.float32([0, 0, 1])) / 0.5
    assert (found.normal * outwards).sum(axis=1).min() > 0.99
    assert ((found.normal * hits.direction).sum(axis=1) < 0).all()


@pytest.mark.parametrize("clusters", [64, 512])
def test_a_mirror_floor_sends_up_the_light_that_falls_on_it(clusters: int) -> None:
    """A lamp of 16 degrees counts as its own size, not as a whole number of light clusters."""
    v, u = (np.arange(64) + 0.5) / 64 * np.pi, (np.arange(128) + 0.5) / 64 * np.pi
    radiance = np.full((64, 128, 3), 0.1, np.float32)
    for azimuth in (0.4, 2.3, 4.1):
        cosine = np.cos(v)[:, None] * np.cos(0.9) + np.sin(v)[:, None] * np.sin(0.9) * np.cos(u - azimuth)
        radiance[cosine > np.cos(0.28)] = 10
    env = EnvMap.from_array(radiance)
    settings = replace(EVERY, clusters=clusters, texels=2048)
    around, seen = ball.ground(0.9, 0.02, 1.0), ball.surface(ball.camera((0, 0.01, -3)))
    relit = ball.relit(seen, np.float32([0, 0, 0])).around(prepare_light(env, 2048, clusters), around, settings)
    up = np.float32([[0, 0, 0.4]])
    normal = np.float32([[0, 0, -1]])
    scene = around.around(relit.mesh)
    hits = scene.cluster_hits(up, normal, relit.lighting.light.clusters)
    lit = relit.lighting.light.clusters
    sent = relit.sent.towards(PixelRays(hits, lit.direction, normal, np.int32([-1])))[:, 0]
    cosine = np.maximum(-lit.direction[2], 0) * lit.solid_angle * (hits[0] >= len(relit.mesh.faces))
    whole = np.maximum(lit.direction[2], 0) @ lit.energy.T
    assert (sent @ cosine)[0] == pytest.approx(0.9 * whole[0], rel=0.06)


def test_at_the_foot_a_divided_pixel_shows_the_ground_beside_it() -> None:
    """Its own middle may lie under the foot; far from the foot, and where nothing is free, pixels keep their own."""
    seen, shape = view(), (24, 32)
    pixels = seen.pixels
    foot = box((-0.2, -0.2, 0.0), (0.2, 0.2, 0.05))
    place = pixels.position
    under = (np.abs(place[:, :2]) < 0.25).all(axis=1)
    opacity = np.zeros(shape, np.float32)
    opacity.reshape(-1)[pixels.index[under | (place[:, 1] > 3)]] = 0.5
    mix = subject_edge(seen, opacity, foot)
    dark = np.where(under, 0, 1).astype(np.float32)[:, None]
    found = mix.of(dark)
    assert set(mix.pixel) <= set(np.flatnonzero(under))
    assert len(mix.pixel) > 3
    np.testing.assert_allclose(found[mix.pixel], 1, atol=1e-6)
    np.testing.assert_array_equal(found[~under], 1)
    assert not len(subject_edge(seen, np.ones(shape, np.float32), foot).pixel)


def test_a_lifted_origin_stays_outside_a_foot_that_widens_upwards() -> None:
    """Points at the foot of a cone that stands on its tip: straight up, their origins would lie inside it."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = np.concatenate([0.1 * around, np.full((12, 1), -0.004)], axis=1).astype(np.float32)
    normal = np.concatenate([around, np.full((12, 1), -0.5)], axis=1) / np.sqrt(1.25)
    found = lifted(points, normal.astype(np.float32), np.float32(0.002))
    np.testing.assert_allclose(found[:, 2], 0.002, atol=1e-7)
    assert (((found - points) * normal).sum(axis=1) > -1e-6).all(), "on the outer side of the surface"
    np.testing.assert_array_equal(lifted(points, normal.astype(np.float32), np.float32(-1)), points)
    flat = np.broadcast_to(np.float32([0, 0, -1]), points.shape)
    np.testing.assert_allclose(lifted(points, flat, np.float32(0.002))[:, :2], points[:, :2], atol=1e-6)
