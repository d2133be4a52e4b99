from dataclasses import replace

import numpy as np
import pytest

from tests.relight.scenes import box_mesh, camera, sky, sphere, surface
from yesnt.core.errors import JobError
from yesnt.relight import (
    EnvMap,
    FrameInputs,
    GBuffer,
    ProxyScene,
    RelightSettings,
    prepare_capture,
    prepare_relight,
    relight_frame,
    shade,
)
from yesnt.relight.brdf import alpha_ggx
from yesnt.relight.points import gather_pixels

DRAFT = RelightSettings.from_quality("draft", edges=False, pixel_filter=0.0)


def relight(plate, gbuffer, cam, env, capture, settings, proxy=None):
    lights = prepare_relight(env, settings), prepare_capture(capture, settings)
    return relight_frame(FrameInputs(plate, surface(gbuffer, cam)), *lights, proxy, settings)


def floor_and_block():
    """A floor seen from above with a block hovering over its middle, as a G-buffer of the floor alone."""
    pose = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3.0], [0, 0, 0, 1]])
    from yesnt.core.camera import Camera

    cam = Camera(20, 20, 20.0, 20.0, 10.0, 10.0, {1: pose})
    ones = np.ones((20, 20), np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (20, 20, 1))
    gbuffer = GBuffer(np.full((20, 20, 3), 0.5, np.float32), ones, 0 * ones, normal, 3 * ones, ones)
    return gbuffer, cam, ProxyScene.from_arrays(*box_mesh((-0.4, -0.4, 0.2), (0.4, 0.4, 0.6)))


@pytest.mark.parametrize("brdf", ["default", "paper"])
@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
def test_the_capture_light_is_inverted_exactly(brdf, metallic):
    gbuffer, cam = sphere(metallic=metallic)
    settings = replace(DRAFT, shadows=False, brdf=brdf, texels=128, clusters=32)
    env = sky(16)
    plate = relight(
        gbuffer.base_color, gbuffer, cam, env, env, RelightSettings(**{**vars(settings), "base_color": "plate"})
    )
    back = relight(plate.radiance, gbuffer, cam, env, env, settings)
    inside = gbuffer.opacity > 0
    assert np.allclose(back.base_color[inside], gbuffer.base_color[inside], atol=2e-3)
    assert np.allclose(back.radiance[inside], plate.radiance[inside], rtol=5e-3, atol=1e-4)


def test_relit_under_its_own_light_the_plate_comes_back_with_shadows_and_bounce():
    gbuffer, cam, proxy = floor_and_block()
    env = sky(16)
    few = {"texels": 128, "clusters": 32, "capture_clusters": 32, "pixel_filter": 0.0}
    lit = RelightSettings.from_quality("draft", base_color="plate", **few)
    inverse = RelightSettings.from_quality("draft", capture_passes=4, **few)
    plate = relight(gbuffer.base_color, gbuffer, cam, env, env, lit, proxy)
    back = relight(plate.radiance, gbuffer, cam, env, env, inverse, proxy)
    bright = plate.shadow > 0.05
    assert np.allclose(back.radiance[bright], plate.radiance[bright], rtol=0.02, atol=2e-3)


def test_a_black_plate_stays_black_and_finite():
    gbuffer, cam = sphere(metallic=1.0)
    dark = EnvMap.from_array(np.zeros((8, 16, 3)))
    relit = relight(np.zeros((24, 24, 3)), gbuffer, cam, sky(), dark, DRAFT)
    assert (relit.base_color == 0).all()
    assert np.isfinite(relit.radiance).all()


def test_a_block_shades_the_floor_below_it_and_the_bounce_fills_some_in():
    gbuffer, cam, proxy = floor_and_block()
    env = EnvMap.from_array(np.ones((16, 32, 3)))
    plate = np.full((20, 20, 3), 0.5, np.float32)
    open_, dark, bounced = (
        relight(
            plate,
            gbuffer,
            cam,
            env,
            env,
            RelightSettings.from_quality("draft", base_color="plate", error=0.0, **knobs),
            proxy,
        )
        for knobs in ({"shadows": False}, {"bounce": 0}, {"bounce": 2})
    )
    assert dark.shadow[10, 10] < 0.6 < 0.9 < dark.shadow[0, 0]
    assert dark.radiance[10, 10, 0] < bounced.radiance[10, 10, 0] < open_.radiance[10, 10, 0]
    assert (open_.shadow == 1).all()


@pytest.mark.parametrize("shadows", [False, "single", True])
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_static_in_static_out(quality, shadows):
    gbuffer, cam = sphere((12, 12))
    runs = [shade(gbuffer, sky(), cam, quality, shadows) for _ in range(2)]
    assert len({run.radiance.tobytes() + run.shadow.tobytes() for run in runs}) == 1


@pytest.mark.parametrize("quality", ["draft", "standard", "final", "reference"])
def test_a_static_frame_under_a_static_light_gives_identical_bits_at_every_quality(quality):
    """Two frames of one camera, everything made anew: plate inverted, shadows and bounces off the proxy, edges."""
    gbuffer, cam, proxy = floor_and_block()
    gbuffer.roughness[:10], gbuffer.metallic[:, :10] = 0.1, 1.0
    cam = replace(cam, poses={1: cam.poses[1], 2: cam.poses[1]})
    settings, bits = RelightSettings.from_quality(quality), set()
    for frame in (1, 2):
        env, capture = prepare_relight(sky(32), settings), prepare_capture(sky(8, seed=1), settings)
        inputs = FrameInputs(gbuffer.base_color, surface(gbuffer, cam, frame))
        relit = relight_frame(inputs, env, capture, replace(proxy), settings)
        bits.add(b"".join(image.tobytes() for image in (relit.base_color, relit.diffuse, relit.specular, relit.shadow)))
    assert len(bits) == 1


def test_metal_seen_in_metal_shows_what_it_mirrors():
    """A mirror below a mirror of base colour 0.5 under uniform light 1 shows 0.5 x 0.5 there, not black."""
    gbuffer, cam, proxy = floor_and_block()
    gbuffer.metallic[:], gbuffer.roughness[:] = 1.0, 0.1
    env = EnvMap.from_array(np.ones((16, 32, 3)))
    settings = RelightSettings.from_quality("draft", base_color="plate", edges=False, bounce=1)
    relit = relight(gbuffer.base_color, gbuffer, cam, env, env, settings, proxy).radiance[..., 0]
    assert 0.2 < relit[10, 10] < 0.32
    assert np.isclose(relit[0, 0], 0.5, atol=0.05)


def test_a_sharp_pixel_sees_an_occluder_along_its_mirrored_view():
    """A lamp of one texel straight up, behind the block: hidden from the middle, seen from the corner."""
    gbuffer, cam, proxy = floor_and_block()
    gbuffer.metallic[:], gbuffer.roughness[:] = 1.0, 0.05
    env = EnvMap.from_array(np.ones((16, 32, 3)))
    few = {"base_color": "plate", "edges": False, "bounce": 0, "clusters": 8, "texels": 64}
    relit = relight(gbuffer.base_color, gbuffer, cam, env, env, RelightSettings.from_quality("draft", **few), proxy)
    shadow = relit.shadow
    assert shadow[10, 10] < 0.1
    assert shadow[0, 0] > 0.9


def test_a_tile_more_or_less_changes_no_bit():
    gbuffer, cam, proxy = floor_and_block()
    plate = np.full((20, 20, 3), 0.5, np.float32)
    runs = [
        relight(plate, gbuffer, cam, sky(), sky(8), RelightSettings.from_quality("draft", tile=tile), proxy).radiance
        for tile in (37, 8192)
    ]
    assert np.array_equal(*runs)


def _thirds(z):
    z[::3], z[1::3], z[2::3] = 0, 1e10, np.nan
    return z


IMAGES = {
    "roughness 0": lambda g: {"roughness": 0 * g["roughness"]},
    "roughness 1": lambda g: {"roughness": 0 * g["roughness"] + 1},
    "normals away": lambda g: {"normal": -g["normal"]},
    "normals zero": lambda g: {"normal": 0 * g["normal"]},
    "normals nan": lambda g: {"normal": g["normal"] * np.nan},
    "grazing": lambda g: {"normal": np.cross(g["normal"], camera((10, 12)).rays(1)).astype(np.float32)},
    "z": lambda g: {"z": _thirds(g["z"].copy())},
    "z 0": lambda g: {"z": 0 * g["z"]},
    "z 1e10": lambda g: {"z": np.full_like(g["z"], 1e10)},
    "z nan": lambda g: {"z": g["z"] * np.nan},
    "matte 0": lambda g: {"opacity": 0 * g["opacity"]},
    "half": lambda g: {key: np.minimum(value, 6e4).astype(np.float16) for key, value in g.items()},
    "materials nan": lambda g: {key: g[key] * np.nan for key in ("roughness", "metallic", "base_color")},
    "1x1": lambda g: {key: value[5:6, 6:7] for key, value in g.items()},
}
RADIANCE = {
    "sun": np.where(np.arange(8 * 16).reshape(8, 16, 1) == 37, 1e7, 0.1) * np.ones(3),
    "black map": np.zeros((8, 16, 3)),
    "1x2 map": np.array([[[1.0, 2, 3], [4, 5, 6]]]),
    "negative map": np.full((4, 8, 3), -1.0),
    "nan map": np.full((4, 8, 3), np.nan),
    "bad map": np.where(np.arange(3) == 0, np.nan, -1.0) * np.ones((4, 8, 1)),
}


def _extreme(name):
    gbuffer, cam = sphere((10, 12))
    images = {**vars(gbuffer), **IMAGES.get(name, lambda _: {})(vars(gbuffer))}
    env = EnvMap.from_array(RADIANCE[name]) if name in RADIANCE else sky(8)
    return GBuffer(**images), camera((1, 1)) if name == "1x1" else cam, env


@pytest.mark.parametrize("name", [*IMAGES, *RADIANCE])
@pytest.mark.parametrize("brdf", ["default", "paper"])
@pytest.mark.parametrize("shadows", [False, "single", True])
def test_extremes_give_finite_non_negative_pixels(name, brdf, shadows):
    gbuffer, cam, env = _extreme(name)
    shading = shade(gbuffer, env, cam, "draft", shadows, brdf)
    for image in (shading.diffuse, shading.specular, shading.radiance, shading.shadow):
        assert np.isfinite(image).all()
        assert (image >= 0).all()
    assert (shading.shadow <= 1).all()
    relit = relight(np.full_like(shading.radiance, np.inf), gbuffer, cam, env, env, DRAFT)
    assert np.isfinite(relit.radiance).all()
    assert (relit.radiance >= 0).all()


@pytest.mark.parametrize("name", [*IMAGES, *RADIANCE])
def test_extremes_with_a_proxy_give_finite_non_negative_pixels(name):
    """Standard quality: sparse rays, bounces, metal in metal, edges."""
    gbuffer, cam, env = _extreme(name)
    gbuffer = replace(gbuffer, metallic=np.where(np.isnan(gbuffer.metallic), np.nan, np.eye(*gbuffer.metallic.shape)))
    proxy = ProxyScene.from_arrays(*box_mesh((-0.4, -1.6, -0.4), (0.4, -1.2, 0.4)))
    plate = np.where(np.arange(3) == 0, np.nan, 0.5) * np.ones((*gbuffer.z.shape, 1))
    relit = relight(plate, gbuffer, cam, env, env, RelightSettings.from_quality("standard", texels=256), proxy)
    for image in (relit.base_color, relit.diffuse, relit.specular, relit.radiance, relit.shadow):
        assert np.isfinite(image).all()
        assert (image >= 0).all()


def test_no_matte_gives_black_and_no_pixel_is_touched_outside_it():
    gbuffer, cam, env = _extreme("matte 0")
    assert not shade(gbuffer, env, cam, "standard").radiance.any()
    gbuffer, cam, env = _extreme("roughness 0")
    assert not shade(gbuffer, env, cam, "standard").radiance[gbuffer.opacity == 0].any()


def test_half_precision_images_give_what_single_ones_do():
    gbuffer, cam, env = _extreme("half")
    wide = GBuffer(**{key: value.astype(np.float32) for key, value in vars(gbuffer).items()})
    assert np.array_equal(shade(gbuffer, env, cam, "draft").radiance, shade(wide, env, cam, "draft").radiance)


def test_a_mirror_that_turns_within_a_pixel_is_less_sharp_and_a_flat_one_or_an_edge_is_not():
    gbuffer, cam = sphere((24, 24), roughness=0.1)
    px = gather_pixels(surface(gbuffer, cam))
    middle = np.flatnonzero(px.index == 12 * 24 + 12)[0]
    step = 3 / (1.7 * 24)  # metres a pixel at the front of a sphere of 1 m: radians of its normal
    assert np.isclose(px.turn[middle], 2 * step**2, rtol=0.05)
    everything = slice(0, len(px.index))
    assert (px.lobes(everything, "default").alpha > alpha_ggx(px.roughness)).all()
    assert np.allclose(px.lobes(everything, "paper").alpha, alpha_ggx(px.roughness))
    flat = np.broadcast_to(np.float32([0, -1, 0]), (24, 24, 3)).copy()
    flat[:, 12:] = [0, 0, 1]
    gbuffer = replace(gbuffer, normal=flat, opacity=np.ones((24, 24), np.float32))
    assert not gather_pixels(surface(gbuffer, cam)).turn.any()


def test_averaged_normals_take_the_light_of_the_surfaces_that_they_mix():
    gbuffer, cam = sphere((24, 24))
    normal = gbuffer.normal.copy()
    normal[:, 12:] = [0.0, 0.0, 1.0]
    normal[:, :12] = [0.0, -1.0, 0.0]
    images = {**vars(gbuffer), "normal": normal, "opacity": np.ones((24, 24), np.float32)}
    mixed = {**images, "normal": normal.copy()}
    mixed["normal"][:, 12] = 0.5 * (normal[:, 11] + normal[:, 13])
    env = sky()
    whole, edge = (shade(GBuffer(**g), env, cam, "draft", False).radiance for g in (images, mixed))
    middle = 0.5 * (whole[:, 11] + whole[:, 13])
    plain = shade(GBuffer(**mixed), env, cam, DRAFT, False).radiance
    assert np.abs(edge[:, 12] - middle).mean() < 0.7 * np.abs(plain[:, 12] - middle).mean()
    assert np.array_equal(edge[:, :12], whole[:, :12])


def test_a_seam_of_metal_takes_the_light_of_both_sides():
    gbuffer, cam = sphere((24, 24))
    images = {
        **vars(gbuffer),
        "opacity": np.ones((24, 24), np.float32),
        "roughness": np.full((24, 24), 0.2, np.float32),
    }
    images["normal"] = np.broadcast_to(np.float32([0.0, -1.0, 0.0]), (24, 24, 3)).copy()
    metallic = np.zeros((24, 24), np.float32)
    metallic[:, 12:] = 1.0
    images["base_color"] = np.where(metallic[..., None] > 0, np.float32([0.9, 0.7, 0.3]), np.float32([0.1, 0.2, 0.6]))
    whole = shade(GBuffer(**{**images, "metallic": metallic}), sky(), cam, "draft", False).radiance
    metallic, images["base_color"] = metallic.copy(), images["base_color"].copy()
    metallic[:, 12] = 0.5
    images["base_color"][:, 12] = (0.5, 0.45, 0.45)
    mixed = GBuffer(**{**images, "metallic": metallic})
    middle = 0.5 * (whole[:, 11] + whole[:, 13])
    resolved, plain = (shade(mixed, sky(), cam, s, False).radiance for s in ("draft", DRAFT))
    assert np.abs(resolved[:, 12] - middle).mean() < 0.7 * np.abs(plain[:, 12] - middle).mean()
    assert np.array_equal(resolved[:, :12], whole[:, :12])


def test_settings_refuse_what_they_do_not_know():
    with pytest.raises(JobError, match="Quality 'fast' is unknown"):
        RelightSettings.from_quality("fast")
    with pytest.raises(JobError, match="no knob sampels"):
        RelightSettings.from_quality("draft", sampels=3)
    with pytest.raises(JobError, match="`clusters` cannot be 0"):
        RelightSettings.from_quality("draft", clusters=0)
    with pytest.raises(JobError, match="`diffuse` cannot be 'disney'"):
        RelightSettings.from_quality("draft", brdf="paper", diffuse="disney")
    with pytest.raises(JobError, match="triangle mesh"):
        ProxyScene.from_arrays(np.zeros((3, 2)), [[0, 1, 2]])
    with pytest.raises(JobError, match="lacks"):
        ProxyScene.from_arrays(np.zeros((3, 3)), [[0, 1, 3]])
