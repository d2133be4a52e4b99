import numpy as np

from tests.relight.scenes import sky
from tests.relight.test_frame import relight
from yesnt.core.camera import Camera
from yesnt.relight import GBuffer, ProxyScene, RelightSettings
from yesnt.relight.sparse import STEP, bands


def scene(size=48):
    """A floor seen from above, a block of half its width over the middle."""
    from tests.relight.scenes import box_mesh

    pose = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3.0], [0, 0, 0, 1]])
    cam = Camera(size, size, 1.0 * size, 1.0 * size, size / 2, size / 2, {1: pose})
    ones = np.ones((size, size), np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (size, size, 1))
    gbuffer = GBuffer(np.full((size, size, 3), 0.5, np.float32), ones, 0 * ones, normal, 3 * ones, ones)
    return gbuffer, cam, ProxyScene.from_arrays(*box_mesh((-0.4, -0.4, 0.2), (0.4, 0.4, 0.6)))


def test_sparse_rays_give_what_every_ray_gives_for_far_fewer(monkeypatch):
    gbuffer, cam, proxy = scene()
    traced, plain = [], ProxyScene.first_hits
    monkeypatch.setattr(ProxyScene, "first_hits", lambda s, o, d: (traced.append(len(o)), plain(s, o, d))[1])
    relit, cost = [], []
    for rays in ("every", "sparse"):
        traced.clear()
        settings = RelightSettings.from_quality("draft", base_color="plate", bounce=0, rays=rays)
        relit.append(relight(gbuffer.base_color, gbuffer, cam, sky(), sky(8), settings, proxy).radiance)
        cost.append(sum(traced))
    assert cost[1] < 0.6 * cost[0]
    assert np.abs(relit[0] - relit[1]).mean() < 1e-3 * relit[0].mean()


def test_pixels_across_a_step_in_depth_are_traced_themselves():
    """Two floors at different heights: nothing is told across the step, so both ways cast the same shadow there."""
    gbuffer, cam, proxy = scene()
    gbuffer.z[:, 24:] = 2.9
    relit = [
        relight(
            gbuffer.base_color, gbuffer, cam, sky(), sky(8),
            RelightSettings.from_quality("draft", base_color="plate", bounce=0, rays=rays), proxy,
        ).shadow[:, 22:27]
        for rays in ("every", "sparse")
    ]  # fmt: skip
    assert relit[0].min() < 0.7
    assert np.abs(relit[0] - relit[1]).mean() < 5e-3


def test_bands_cover_every_pixel_once_and_begin_at_anchor_rows():
    gbuffer, cam, _ = scene(20)
    from tests.relight.scenes import surface
    from yesnt.relight.points import gather_pixels

    gbuffer.opacity[:7, ::3] = 0
    pixels = gather_pixels(surface(gbuffer, cam))
    found = bands(pixels, 50)
    assert [band.part.start for band in found] == [0, *(band.part.stop for band in found[:-1])]
    assert found[-1].part.stop == len(pixels.index)
    assert all(pixels.index[band.part.start] // 20 % STEP == 0 for band in found)
