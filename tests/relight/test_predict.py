import numpy as np
import pytest

from tests.relight.scenes import sky
from tests.relight.test_frame import floor_and_block, relight
from yesnt.relight import RelightSettings, prepare_light, requirements
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
    assert not found["texels of several sizes"].modelled
    assert not found["metallic lobe"].modelled
