from dataclasses import replace

import numpy as np
import pytest

from tests.relight.scenes import sky
from tests.relight.test_frame import floor_and_block, relight
from tests.relight.test_kernels import pixels
from yesnt.relight import RelightSettings, indirect, prepare_light, requirements
from yesnt.relight.indirect import LEVELS
from yesnt.relight.kernels import sum_lobes
from yesnt.relight.predict import bounces_worth
from yesnt.relight.scope import SceneFacts


def test_looser_errors_take_fewer_clusters_and_keep_what_they_promise():
    tight, loose = (prepare_light(sky(64), 2048, 512, error=error) for error in (0.004, 0.02))
    assert len(loose.clusters) < len(tight.clusters) <= 512
    assert loose.shadow_error <= 0.02
    assert tight.shadow_error <= 0.004 or len(tight.clusters) == 512
    assert len(prepare_light(sky(64), 2048, 512).clusters) == 512


@pytest.mark.parametrize("seed", [1, 2])
def test_the_prediction_bounds_the_error_of_shadows(seed):
    """Under a block, against 1,024 clusters: within a factor of three either way of what was predicted."""
    gbuffer, cam, proxy = floor_and_block()
    env, plate = sky(64, seed), np.full((20, 20, 3), 0.5, np.float32)
    many, few = (
        relight(plate, gbuffer, cam, env, env, RelightSettings.from_quality("standard", base_color="plate", **k), proxy)
        for k in ({"error": 0.0, "clusters": 1024}, {"error": 0.02})
    )
    found = np.sqrt(np.square(few.radiance**0.45 - many.radiance**0.45).mean())
    predicted = prepare_light(env, 2048, 512, 256, 32, error=0.02).shadow_error
    assert predicted / 3 < found < 3 * predicted


def test_bounces_are_kept_where_they_are_worth_it():
    assert bounces_worth(hidden=0.0, albedo=0.8, error=0.01, most=4) == 0
    assert bounces_worth(hidden=0.3, albedo=0.2, error=0.01, most=4) == 1
    assert bounces_worth(hidden=0.6, albedo=0.9, error=0.01, most=4) == 4
    assert bounces_worth(hidden=0.1, albedo=0.1, error=0.0, most=4) == 4


def test_plan_says_how_many_rays_and_what_a_constant_material_leaves_out():
    light = prepare_light(sky(64), 2048, 512, error=0.01)
    facts = SceneFacts(light, light, True, (0.4, 0.4), (0.0, 0.0))
    found = {r.term: r for r in requirements(facts, RelightSettings(error=0.01))}
    assert f"{len(light.clusters)} rays" in found["shadows"].reason
    assert "predicted display error" in found["shadows"].reason
    assert not found["map filtered for metal in metal"].modelled
    assert not found["metallic lobe"].modelled


def test_fine_texels_that_plan_leaves_out_are_not_read():
    """Broken on purpose, they change no bit; a sharper lobe reads them, and plan says so."""
    light = prepare_light(sky(64), 2048, 64)
    whole, rows = light.texels.start[0, -1] * 8, light.texels.rows.copy()
    rows[3:7, whole:] = np.nan
    broken = replace(light, texels=replace(light.texels, rows=rows))
    for roughness, modelled in ((0.9, False), (0.1, True)):
        facts = SceneFacts(light, light, True, (roughness, 1.0), (1.0, 1.0))
        found = {r.term: r for r in requirements(facts, RelightSettings())}
        assert found["fine texels for sharp lobes"].modelled == modelled
        lobes = pixels(np.float32(roughness)).lobes(slice(0, 300), "default")
        one, two = (sum_lobes(lobes, which, None, None) for which in (light, broken))
        assert np.array_equal(one, two) != modelled


def test_constant_roughness_filters_one_level_for_metal_in_metal(monkeypatch):
    gbuffer, cam, proxy = floor_and_block()
    filtered, plain = [], indirect._filtered
    monkeypatch.setattr(indirect, "_filtered", lambda light, level: (filtered.append(level), plain(light, level))[1])
    for metallic, levels in ((0.0, set()), (1.0, {LEVELS.index(0.25)})):
        filtered.clear()
        gbuffer.metallic[:], gbuffer.roughness[:] = metallic, 0.3
        settings = RelightSettings.from_quality("draft", base_color="plate")
        relight(gbuffer.base_color, gbuffer, cam, sky(), sky(8), settings, proxy)
        assert set(filtered) == levels
        facts = SceneFacts(None, None, True, (0.3, 0.3), (metallic, metallic))
        found = {r.term: r for r in requirements(facts, settings)}["map filtered for metal in metal"]
        assert found.modelled == bool(levels)
        assert ("one level" in found.reason) == bool(levels)
