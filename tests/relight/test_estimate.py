import numpy as np

from tests.relight.scenes import sphere, surface
from yesnt.relight import EnvMap, RelightSettings, estimate_capture, prepare_light, requirements, shade
from yesnt.relight.envmap import uv_to_direction
from yesnt.relight.harmonics import BANDS, basis
from yesnt.relight.scope import SceneFacts, shadow_blur


def test_harmonics_are_orthonormal_and_give_irradiance():
    light = prepare_light(EnvMap.from_array(np.ones((64, 128, 3))), 8192, 64)
    texels = light.texels
    values = basis(texels.direction.T) * np.sqrt(texels.solid_angle)[:, None]
    assert np.allclose(values.T @ values, np.eye(9), atol=5e-3)
    facing = np.maximum(texels.direction[2], 0) * np.sqrt(texels.solid_angle)
    up = basis(np.array([0.0, 0.0, 1.0]))
    assert np.allclose(values.T @ facing, np.repeat(BANDS, [1, 3, 5]) * up, atol=5e-3)  # Funk-Hecke


def _plate(env):
    gbuffer, cam = sphere((32, 32), roughness=1.0)
    gbuffer.base_color[:16] = (0.2, 0.5, 0.3)
    return shade(gbuffer, env, cam, "draft", shadows=False).radiance, surface(gbuffer, cam)


def test_a_directed_light_is_found_on_its_side():
    u, v = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(32) + 0.5) / 32)
    lamp = 0.1 + 8 * np.clip(uv_to_direction(u, v) @ np.array([0.8, -0.6, 0.0]), 0, 1) ** 8
    found = estimate_capture(*zip(_plate(EnvMap.from_array(np.repeat(lamp[..., None], 3, -1))), strict=True))
    lit, dark = found.lookup(np.array([[0.8, -0.6, 0], [-0.8, -0.6, 0]]))
    assert lit[0] > 1.5 * dark[0]
    assert np.isclose(found.radiance.mean(), 1, atol=0.2)


def test_an_even_light_or_no_pixels_give_the_uniform_light():
    plate, seen = _plate(EnvMap.from_array(np.ones((8, 16, 3))))
    assert np.allclose(estimate_capture([plate], [seen]).radiance, 1)
    assert np.allclose(estimate_capture([], []).radiance, 1)


def test_requirements_name_every_term_with_its_reason():
    radiance = np.full((32, 64, 3), 0.1, np.float32)
    radiance[8, 8] = 1e4
    light = prepare_light(EnvMap.from_array(radiance), 512, 64)
    even = prepare_light(EnvMap.from_array(np.ones((8, 16, 3))), 128, 64)
    settings = RelightSettings()
    found = {r.term: r for r in requirements(SceneFacts(light, even, False, (0.6, 0.9), (0.0, 0.0)), settings)}
    assert found["sun"].modelled
    assert not found["metallic lobe"].modelled
    assert not found["map filtered for metal in metal"].modelled
    assert not found["bounce"].modelled
    assert "uniform" in found["capture light"].reason
    assert "z" in found["shadows"].reason
    off = RelightSettings(shadows=False, base_color="plate", brdf="paper")
    found = {r.term: r for r in requirements(SceneFacts(even, even, True), off)}
    assert [found[t].modelled for t in ("sun", "shadows", "bounce", "capture light")] == [False] * 4
    assert shadow_blur(light) < shadow_blur(even)
