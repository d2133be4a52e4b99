import numpy as np
import pytest

from tests.relight.scenes import sky, sphere
from tests.relight.test_kernels import pixels
from yesnt.relight import RelightSettings, prepare_light, shade
from yesnt.relight.kernels import sum_lobes
from yesnt.relight.torch_sum import sum_lobes_torch


@pytest.mark.parametrize(("brdf", "diffuse"), [("default", "lambert"), ("default", "disney"), ("paper", "lambert")])
@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.7])
def test_torch_equals_numba(brdf, diffuse, roughness):
    light, rng = prepare_light(sky(32), 256, 32), np.random.default_rng(0)
    px = pixels(np.float32(roughness), np.float32(0.4), count=64)
    lobes = px.lobes(slice(0, 64), brdf, diffuse)
    hidden = rng.random((64, 32)) < 0.3
    bounce = rng.random((3, 64, 32)).astype(np.float32)
    for occluded in ((None, None), (hidden, None), (hidden, bounce)):
        one = sum_lobes(lobes, light, *occluded, brdf != "paper")
        two = sum_lobes_torch(lobes, light, *occluded, brdf != "paper", device="cpu")
        assert np.allclose(one, two, rtol=2e-3, atol=1e-5 * np.abs(one).max())


def test_a_frame_by_torch():
    gbuffer, cam = sphere((8, 8))
    draft = RelightSettings.from_quality("draft")
    torch_ = RelightSettings.from_quality("draft", engine="torch")
    one, two = (shade(gbuffer, sky(), cam, s).radiance for s in (draft, torch_))
    assert np.allclose(one, two, rtol=2e-3, atol=1e-5)
