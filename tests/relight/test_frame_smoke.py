import numpy as np

from yesnt.relight import Camera, EnvMap, GBuffer, RelightSettings, shade


def test_white_furnace_of_a_facing_plane():
    camera = Camera(3, 2, 3.0, 3.0, 1.5, 1.0, {1: np.eye(4)})
    ones = np.ones((2, 3), dtype=np.float32)
    gbuffer = GBuffer(
        np.ones((2, 3, 3), np.float32), 0.7 * ones, 0 * ones, np.tile(np.float32([0, 0, -1]), (2, 3, 1)), 2 * ones, ones
    )
    env = EnvMap.from_array(np.ones((32, 64, 3)))
    shading = shade(gbuffer, env, camera, shadows=False)
    assert np.allclose(shading.radiance, 1, atol=0.01)
    assert (shading.shadow == 1).all()
    assert RelightSettings.from_quality("draft", clusters=8).clusters == 8
