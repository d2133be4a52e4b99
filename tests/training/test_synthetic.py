import dataclasses

import numpy as np
import pytest
import torch

from yesnt.decompose.network import sample_at_patch
from yesnt.training.synthetic.dataset import (
    Patches,
    crop,
    draw_image,
    draw_mix,
    draw_patches,
    expose,
    recolour_garments,
)
from yesnt.training.synthetic.light import COLUMNS, LEVELS, ROWS, Light, draw_light, environment_brdf
from yesnt.training.synthetic.materials import CLASSES, MATERIAL, PRIOR, draw_class, paint
from yesnt.training.synthetic.render import Rendering, paint_surface, render
from yesnt.training.synthetic.shapes import EMPTY, GeometryBuffer
from yesnt.training.synthetic.tiles import NAMES, tile_bank


def ball(radius=40.0, size=128):
    geometry = GeometryBuffer.empty(size)
    centre = np.array([size / 2, size / 2, 0.0, radius])
    geometry.capsule(centre, centre + np.array([0.01, 0, 0, 0]), 1.0, 0)
    return geometry


def plain(roughness, metallic, base=1.0):
    material = np.zeros(1, MATERIAL)
    material["base"], material["second"], material["roughness"], material["metallic"] = base, base, roughness, metallic
    return material


def uniform():
    return Light(np.ones((ROWS, COLUMNS, 3), np.float32), np.ones((len(LEVELS), ROWS, COLUMNS, 3), np.float32))


@pytest.mark.parametrize("roughness", [0.1, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_white_furnace(roughness, metallic):
    image = render(ball(), plain(roughness, metallic), uniform())
    inner = image.rgb[:, 28:36, 28:36]
    # The paint's white is limited to 0.98; energy may be lost by occlusion, never made.
    assert inner.max() <= 1.0
    assert inner.min() > 0.9


def test_a_black_dielectric_reflects_four_percent_at_normal_incidence():
    image = render(ball(), plain(0.05, 0.0, base=0.0), uniform())
    # The paint's black is limited to 0.002, nearly all of it diffuse.
    np.testing.assert_allclose(image.rgb[:, 31:33, 31:33], 0.04 + 0.002, atol=2e-3)


def test_a_mirror_shows_the_light_along_the_reflected_direction():
    """Light from the upper half of the image only: the upper half of a mirror ball is bright, the lower dark."""
    half = np.zeros((ROWS, COLUMNS, 3), np.float32)
    half[: ROWS // 2] = 1
    image = render(ball(), plain(0.05, 1.0), Light(half, np.repeat(half[None], len(LEVELS), 0)))
    assert image.rgb[0, 18:28, 30:34].min() > 0.8
    assert image.rgb[0, 36:46, 30:34].max() < 0.05


def test_a_metal_has_no_diffuse_part():
    dark = np.zeros((len(LEVELS), ROWS, COLUMNS, 3), np.float32)
    light = Light(np.ones((ROWS, COLUMNS, 3), np.float32), dark)
    assert not render(ball(), plain(0.5, 1.0), light).rgb.any()
    assert render(ball(), plain(0.5, 0.0), light).rgb[:, 31:33, 31:33].min() > 0.8


def test_bumps_turn_the_normal_away_from_rising_heights():
    geometry = GeometryBuffer.empty(64)
    geometry.sheet(np.array([32.0, 32.0, 0.0, 40.0, 40.0, 0.0]), np.zeros((1, 4)), 0)
    material = plain(0.5, 0.0)
    material["bump"], material["pattern"] = 2.0, NAMES.index("cloudy")
    material["frequency"] = 2.0
    painted = paint_surface(geometry.normal, geometry.uv, geometry.material, material)
    tile = tile_bank()[NAMES.index("cloudy")]
    height = 2.0 * tile[np.ix_(*(np.floor(2 * (np.arange(64) + 0.5 - 32)).astype(int) % 256,) * 2)]
    slope = np.gradient(height, axis=1)[8:56, 8:56]
    assert np.corrcoef(slope.ravel(), painted[5, 8:56, 8:56].ravel())[0, 1] < -0.8


def test_edges_keep_straight_truth_and_class():
    image = render(ball(), plain(0.37, 1.0), uniform())
    edge = (image.matte > 0) & (image.matte < 1)
    assert edge.sum() > 50
    np.testing.assert_allclose(image.truth[0][image.matte > 0], 0.37, atol=1e-5)
    assert set(np.unique(image.kind)) == {-1, 0}


def test_normals_of_a_ball_are_radial():
    geometry = ball()
    y, x = np.nonzero(geometry.material >= 0)
    offset = np.stack([x + 0.5 - 64, y + 0.5 - 64], 1) / 40
    np.testing.assert_allclose(geometry.normal[y, x, :2], offset, atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(geometry.normal[y, x], axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(geometry.z[y, x], 40 * geometry.normal[y, x, 2], atol=0.1)


def test_nearer_shapes_hide_others():
    geometry = ball()
    near = np.array([64.0, 64.0, 100.0])
    geometry.box(near, np.array([10.0, 10.0, 5.0]), np.eye(3), 1)
    geometry.sheet(np.array([64.0, 64.0, -100.0, 200.0, 200.0, 0.0]), np.zeros((1, 4)), 2)
    assert geometry.material[64, 64] == 1
    assert geometry.material[64, 64 + 20] == 0
    assert geometry.material[2, 2] == 2
    np.testing.assert_allclose(geometry.normal[64, 64], [0, 0, 1], atol=1e-6)


def test_cone_with_round_ends_meets_its_spheres():
    geometry = GeometryBuffer.empty(128)
    geometry.capsule(np.array([30.0, 64.0, 0.0, 20.0]), np.array([90.0, 64.0, 10.0, 12.0]), 1.0, 0)
    assert geometry.z[64, 30] == pytest.approx(20, abs=0.6)
    assert geometry.material[64, 90 + 10] == 0
    assert geometry.material[64, 90 + 14] == EMPTY


def test_directional_albedo_is_below_one_and_a_mirror_keeps_everything():
    table = environment_brdf()
    assert (table.sum(2) <= 1.02).all()
    np.testing.assert_allclose(table[16:, 3].sum(1), 1, atol=0.03)
    assert (table >= 0).all()


def test_light_is_uniform_on_average_and_smoother_for_rough_lobes():
    light = draw_light(np.random.default_rng(4))
    contrast = light.specular.std((1, 2, 3))
    assert (np.diff(contrast) < 1e-6).all()
    assert light.diffuse.min() > 0
    weights = np.sin((np.arange(ROWS) + 0.5) * np.pi / ROWS)
    assert np.average(light.diffuse.mean((1, 2)), weights=weights) == pytest.approx(1, abs=0.1)


def test_constant_light_stays_constant_after_prefiltering(monkeypatch):
    monkeypatch.setattr("yesnt.training.synthetic.light._soft_box", lambda rng, direction: 0 * direction[..., 0])
    monkeypatch.setattr("yesnt.training.synthetic.light._towards", lambda rng: np.zeros(3))

    class Still(np.random.Generator):
        def normal(self, *args, **kwargs):
            return 0.0

    light = draw_light(Still(np.random.PCG64(0)))
    np.testing.assert_allclose(light.diffuse, 1, atol=1e-5)
    np.testing.assert_allclose(light.specular, 1, atol=1e-5)


@pytest.mark.parametrize("name", list(CLASSES))
def test_materials_stay_within_their_class(name):
    rng = np.random.default_rng(0)
    drawn = np.array([paint(rng, name) for _ in range(200)])
    _, _, low, high = CLASSES[name].roughness
    assert drawn["roughness"].min() >= np.float32(low)
    assert drawn["roughness"].max() <= np.float32(high)
    assert (drawn["metallic"] == CLASSES[name].metallic).all()
    assert 0 < drawn["base"].min() <= drawn["base"].max() < 1
    assert drawn["roughness"].std() > 0.02, "nothing to be uncertain of"


def test_classes_are_drawn_from_the_prior():
    rng = np.random.default_rng(0)
    drawn = [draw_class(rng) for _ in range(2000)]
    for name, weight in PRIOR.items():
        assert drawn.count(name) / 2000 == pytest.approx(weight / sum(PRIOR.values()), abs=0.03)


def test_tiles_repeat_without_a_seam():
    bank = tile_bank()
    assert bank.shape[0] == len(NAMES)
    for name, tile in zip(NAMES, bank, strict=True):
        inner = np.abs(np.diff(tile, axis=1)).max()
        assert np.abs(tile[:, 0] - tile[:, -1]).max() <= 1.5 * inner + 1e-6, name
        assert abs(float(tile.mean())) < 1e-4


def test_a_patch_is_a_function_of_seed_and_number():
    first, again, other = (draw_patches(seed, index, 2, 64) for seed, index in ((0, 5), (0, 5), (0, 6)))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert (first.rgb != other.rgb).any()
    assert first.rgb.shape == (2, 3, 64, 64)
    assert first.matte.shape == (2, 1, 64, 64)


def test_patches_are_straight_and_truth_lies_inside_the_matte():
    for index in range(4):
        patches = draw_patches(1, index, 2, 96)
        outside = patches.matte[:, 0] == 0
        assert (patches.rgb.transpose(0, 2, 3, 1)[outside] == 0).all()
        assert np.isfinite(patches.rgb).all()
        inside = patches.matte[:, 0] > 0.99
        truth = patches.truth.transpose(0, 2, 3, 1)[inside]
        assert 0.01 < truth[:, 0].min() <= truth[:, 0].max() <= 1
        assert set(np.unique(patches.kind[inside])) <= set(range(-1, len(CLASSES)))


@pytest.mark.parametrize("seed", range(6))
def test_the_whole_shows_the_patch_where_it_says_so(seed):
    """Mirrored or turned, the matte of the patch is the matte of the whole at the patch's place."""
    rng = np.random.default_rng(seed)
    example = crop(rng, draw_image(rng, 144), 64)
    features, location = torch.from_numpy(example.context[None, 3:]), torch.from_numpy(example.location[None])
    sampled = sample_at_patch(features, location, 16)[0, 0].numpy()
    shown = example.matte[0].reshape(16, 4, 16, 4).mean((1, 3))
    rgb = sample_at_patch(torch.from_numpy(example.context[None, :3]), location, 16)[0].numpy()
    patch = example.rgb.reshape(3, 16, 4, 16, 4).mean((2, 4))
    both = (sampled > 0.99) & (shown > 0.99)
    ratio = rgb[:, both].mean(1) / patch[:, both].mean(1)
    np.testing.assert_allclose(ratio, 1, atol=0.15)  # the same exposure and cast
    assert np.abs(sampled - shown).mean() < 0.06
    assert example.context_truth[2].mean() == pytest.approx(example.context[3].mean(), abs=0.02)
    assert ((example.context_kind >= 0) == (example.context_truth[2] > 0.5)).mean() > 0.9


def test_transposing_exchanges_rows_and_columns_of_planes_and_location():
    example = crop(np.random.default_rng(0), draw_image(np.random.default_rng(0), 144), 64)
    turned = example.transposed()
    np.testing.assert_array_equal(turned.location, example.location[[1, 0, 2]])
    np.testing.assert_array_equal(turned.rgb, example.rgb.transpose(0, 2, 1))
    np.testing.assert_array_equal(turned.context_kind, example.context_kind.T)
    twice = example.mirrored().mirrored()
    np.testing.assert_allclose(twice.location, example.location, atol=1e-6)
    np.testing.assert_array_equal(twice.matte, example.matte)


@pytest.mark.parametrize("shrink", [1.0, 1.5])
def test_colours_and_truth_are_straight_at_soft_edges(shrink):
    """A uniform subject: inside the matte every pixel has its values, whatever the coverage."""
    matte = np.clip(1.5 - np.hypot(*np.indices((128, 128)) / 64 - 1)[None] * 1.5, 0, 1)[0].astype(np.float32)
    truth = np.broadcast_to(np.array([0.3, 1.0], np.float32)[:, None, None], (2, 128, 128)) * (matte > 0)
    kind = np.where(matte > 0, 5, -1)
    image = Rendering(np.broadcast_to(0.4 * matte, (3, 128, 128)), matte, truth, kind)
    example = crop(np.random.default_rng(0), image, 64, shrink)
    inside = example.matte[0] > 0.05
    assert ((example.matte[0] > 0.05) & (example.matte[0] < 0.9)).sum() > 100
    np.testing.assert_allclose(example.truth[0][inside], 0.3, atol=2e-3)
    np.testing.assert_allclose(example.truth[1][inside], 1, atol=5e-3)
    whole = example.context_truth[2] > 0.05
    np.testing.assert_allclose(example.context_truth[0][whole], 0.3, atol=2e-3)


def test_exposure_keeps_colours_straight_up_to_gain_and_noise():
    rgb, matte = np.full((3, 64, 64), 0.2, np.float32), np.full((64, 64), 0.5, np.float32)
    for seed in range(8):
        straight, cover, gain = expose(np.random.default_rng(seed), rgb, matte)
        np.testing.assert_allclose(straight.mean((1, 2)), 0.4 * gain, rtol=0.02)
        np.testing.assert_allclose(cover, 0.5, atol=1e-6)
    gains = np.array([expose(np.random.default_rng(seed), rgb[:, :4, :4], matte[:4, :4])[2] for seed in range(400)])
    assert np.log2(gains.mean(1)).std() == pytest.approx(0.4, abs=0.05)


def test_recolouring_gives_cloth_the_colour_of_skin_and_leaves_the_truth():
    names = list(CLASSES)
    kind = np.where(np.arange(40) < 20, names.index("skin"), names.index("woven"))[None].repeat(40, 0)
    colours = np.where(kind == names.index("skin"), 0.4, 0.2) * np.array([1.0, 0.6, 0.4])[:, None, None]
    colours[2, kind == names.index("woven")] *= 3
    image = Rendering(colours.astype(np.float32), np.ones((40, 40), np.float32), np.ones((2, 40, 40)), kind)
    found = [recolour_garments(np.random.default_rng(seed), image) for seed in range(400)]
    hues = [f.rgb[:, 0, 30] / f.rgb[:, 0, 30].sum() - f.rgb[:, 0, 5] / f.rgb[:, 0, 5].sum() for f in found]
    skinlike = np.mean([np.abs(hue).max() < 0.12 for hue in hues])
    assert skinlike == pytest.approx(0.8 * 0.75, abs=0.06)
    for one in found:
        assert one.truth is image.truth
        np.testing.assert_array_equal(one.rgb[:, :, :20], image.rgb[:, :, :20])


@pytest.mark.parametrize("seed", range(5))
def test_turned_colours_keep_white_white_and_grey_grey(seed):
    example = crop(np.random.default_rng(seed), draw_image(np.random.default_rng(seed), 144), 64)
    grey = dataclasses.replace(example, rgb=np.full_like(example.rgb, 0.5), context=np.full_like(example.context, 0.5))
    mix = draw_mix(np.random.default_rng(seed))
    np.testing.assert_allclose(grey.mixed(mix).rgb, 0.5, atol=1e-6)
    np.testing.assert_allclose(grey.mixed(mix).context, 0.5, atol=1e-6)
    assert isinstance(example.mixed(mix), Patches)
    np.testing.assert_allclose(example.mixed(mix).rgb.sum(0), example.rgb.sum(0), rtol=1e-4, atol=1e-5)
