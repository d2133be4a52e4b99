from dataclasses import replace

import numba
import numpy as np
import pytest

from tests.decompose.evidence.scenes import RELIGHT, inputs, smooth_light
from yesnt.decompose.evidence import responses as responses_module
from yesnt.decompose.evidence.observe import Sample, prepare_view, sample_view
from yesnt.decompose.evidence.responses import CaptureScene, LitPoints, probe_points, responses, shares_levels
from yesnt.decompose.evidence.settings import ROUGHNESS, EvidenceSettings
from yesnt.decompose.evidence.triangles import proxy_size, shown_radiance
from yesnt.relight.albedo import multiple_scattering
from yesnt.relight.frame import prepare_capture
from yesnt.relight.occlusion import Occluders, find_occluders
from yesnt.relight.points import Pixels, gather_pixels
from yesnt.relight.proxy import OPEN, ProxyScene
from yesnt.relight.settings import RelightSettings

SETTINGS = EvidenceSettings()
MATERIALS = ((0.35, 0.0, (0.5, 0.2, 0.1)), (0.43, 1.0, (0.8, 0.6, 0.3)), (0.83, 0.5, (0.4, 0.4, 0.4)))


def test_responses_of_the_true_material_give_the_pictures() -> None:
    """Each camera's picture, by a full float64 sum over the map, is b A + D at the true roughness and metallic."""
    directions = [(0.7, -0.7, 0.3), (-0.6, -0.8, -0.2)]
    for roughness, metallic, base in MATERIALS:
        given, _ = inputs(directions, smooth_light(), 20, ((roughness, metallic, base),))
        pixels = gather_pixels(given.surface)
        views = [prepare_view(view, given.proxy, SETTINGS) for view in given.views]
        occluders = find_occluders(given.surface, pixels, given.proxy, RELIGHT)
        scene = CaptureScene(given.light, occluders, shown_radiance(given.proxy, views, SETTINGS), RELIGHT)
        points = probe_points(pixels, np.arange(len(pixels.index)), scene)
        size = proxy_size(given.proxy)
        samples = [sample_view(v, pixels.position, pixels.normal, size, SETTINGS) for v in views]
        of = responses(points, samples, scene, np.array([roughness]))
        b = np.array(base)
        factor = 1 + multiple_scattering(b + (1 - b) / 21, of.average[0]) * of.missing[:, :, 0, None]
        shown = (1 - metallic) * (b * of.diffuse + of.dielectric)[:, :, 0]
        shown = shown + metallic * factor * (b * of.metal_f0 + of.metal_f90)[:, :, 0]
        for v, sample in enumerate(samples):
            ok = sample.valid & ((pixels.normal * sample.towards).sum(1) > 0.4)  # bilinear samples at the rim are blunt
            assert ok.sum() > 40
            relative = np.abs(shown[ok, v] / sample.radiance[ok] - 1)
            assert np.median(relative) < 0.015
            assert np.quantile(relative, 0.95) < 0.06


def test_an_occluded_direction_shows_what_the_cameras_saw_of_the_occluder() -> None:
    given, _ = inputs([(0.7, -0.7, 0.3)], smooth_light(0.0), 20, ((0.9, 0.0, (0.5, 0.5, 0.5)),))
    views = [prepare_view(view, given.proxy, SETTINGS) for view in given.views]
    shown = shown_radiance(given.proxy, views, SETTINGS)
    faces = given.proxy.normals
    facing = faces @ np.array([0.7, -0.7, 0.3]) / np.linalg.norm([0.7, -0.7, 0.3]) > 0.8
    seen = given.views[0].radiance[given.views[0].matte > 0.5]
    np.testing.assert_allclose(shown[:-1][facing].mean(0), np.median(seen, axis=0), rtol=0.1)
    assert not shown[-1].any(), "an open direction adds nothing"
    away = faces @ np.array([0.7, -0.7, 0.3]) < -0.6
    np.testing.assert_allclose(shown[:-1][away].mean(0), 0.5 * np.median(seen, axis=0), rtol=0.15)


def test_a_sharp_lobe_sees_a_small_occluder_that_a_broad_one_misses() -> None:
    """A box of 6 degrees lies where the view is mirrored to, beside the middle of its light cluster."""
    import trimesh

    view = np.float32([0.6, 0, 0.8])
    mirrored = np.array([-0.6, 0, 0.8])
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.apply_translation(mirrored)
    proxy = ProxyScene.from_arrays(box.vertices, box.faces)
    light = prepare_capture(smooth_light(0.0), RELIGHT)
    one, origin = np.ones(1, np.float32), np.zeros((1, 3), np.float32)
    pixels = Pixels(np.zeros(1, np.int64), (1, 1), origin, np.float32([[0, 0, 1]]), view[None], one, one)
    hits = proxy.cluster_hits(origin, pixels.normal, light.clusters)
    assert (hits == OPEN).all(), "the middles of the clusters are free"
    shown = np.concatenate([np.full((len(box.faces), 3), 5), np.zeros((1, 3))]).astype(np.float32)
    occluders = Occluders(origin, proxy, None, np.zeros(1, np.int32), one)
    scene = CaptureScene(light, occluders, shown, RELIGHT)
    sample = Sample(np.ones((1, 3), np.float32), np.zeros((1, 3), np.float32), np.ones(1, bool), view[None], one)
    of = responses(LitPoints(pixels, origin, hits, one), [sample], scene, np.array([0.05, 0.5]))
    mirror, broad = (of.metal_f0 + of.metal_f90)[0, 0, :, 0]
    assert mirror > 1.5, "a cluster is one direction, whose lobe reaches into its neighbours"
    assert broad < 1.1


@pytest.mark.parametrize("relight", [RELIGHT, RelightSettings(capture_texels=64, capture_clusters=16)])
@pytest.mark.parametrize("curved", [False, True])
def test_levels_that_are_summed_together_are_each_by_itself(relight, curved, monkeypatch) -> None:
    """Occluded and open clusters, mirrored rays, curved pixels; many clusters and few, whose texels cut the horizon."""
    random = np.random.default_rng(4)
    points, sample, scene = beside_a_box(40, relight, random)
    if curved:
        turn = random.uniform(0, 0.3, 40).astype(np.float32)
        points = replace(points, pixels=replace(points.pixels, turn=turn))
    levels = np.array(ROUGHNESS)
    together = responses(points, [sample], scene, levels)
    monkeypatch.setattr(responses_module, "shares_levels", lambda settings: False)
    alone = responses(points, [sample], scene, levels)
    assert (points.hits != OPEN).any(axis=1).sum() > 20
    for name, one, other in zip(together._fields, together, alone, strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-5, err_msg=name)
    assert not together.diffuse[~sample.valid].any()


def test_levels_are_summed_to_the_same_bits_in_any_number_of_threads() -> None:
    points, sample, scene = beside_a_box(2100, RelightSettings(capture_texels=64, capture_clusters=16))
    before = numba.get_num_threads()
    found = []
    for threads in (1, before):
        numba.set_num_threads(threads)
        found.append(responses(points, [sample], scene, np.array([0.2, 0.6])))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_shares_no_levels_is_summed_level_by_level() -> None:
    assert shares_levels(RELIGHT)
    for other in ({"brdf": "paper"}, {"diffuse": "disney"}, {"engine": "torch"}):
        assert not shares_levels(replace(RELIGHT, **other))


def beside_a_box(count, relight, random=None):
    """Points on a plane beside a box that sends out light, some unseen, towards one camera under a smooth light."""
    import trimesh

    random = random or np.random.default_rng(1)
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    proxy = ProxyScene.from_arrays(box.vertices, box.faces)
    light = prepare_capture(smooth_light(0.8), relight)
    origin = np.stack([random.uniform(0.55, 1.5, count), random.uniform(-1, 1, count), np.full(count, -0.4)], axis=1)
    normal = random.normal(size=(count, 3)) * 0.3 + [0, 0, 1]
    view = random.normal(size=(count, 3)) * 0.4 + [0.5, 0.2, 0.8]
    origin, normal, view = (a.astype(np.float32) for a in (origin, _unit(normal), _unit(view)))
    one = np.ones(count, np.float32)
    pixels = Pixels(np.arange(count), (1, count), origin, normal, view, one, one)
    hits = proxy.cluster_hits(origin, normal, light.clusters)
    shown = np.concatenate([random.uniform(0, 2, (len(box.faces), 3)), np.zeros((1, 3))]).astype(np.float32)
    scene = CaptureScene(light, Occluders(origin, proxy, None, np.zeros(count, np.int32), one), shown, relight)
    black = np.zeros((count, 3), np.float32)
    return LitPoints(pixels, origin, hits, one), Sample(black, black, random.random(count) < 0.9, view, one), scene


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
