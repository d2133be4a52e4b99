"""The pixel filter: a mean inside the matte, applied only if the G-buffer was sampled at pixel centres."""

from dataclasses import replace

import numpy as np
import pytest

from tests.relight.scenes import camera, sky, sphere
from tests.relight.test_frame import DRAFT, relight
from yesnt.core.errors import JobError
from yesnt.relight import RelightSettings, requirements, shade
from yesnt.relight.pixel_filter import boundaries, filter_light, filter_pixels, read_at_centres, short_normals
from yesnt.relight.scope import SceneFacts

SIDE = RelightSettings().pixel_filter


def reference(image, coverage, side):
    """The definition, pixel by pixel in float64."""
    height, width = coverage.shape
    out = np.zeros(image.shape)
    for y, x in zip(*np.nonzero(coverage), strict=True):
        light, total = 0.0, 0.0
        for j in range(max(0, y - 1), min(height, y + 2)):
            for i in range(max(0, x - 1), min(width, x + 2)):
                share = (side if j != y else 1 - 2 * side) * (side if i != x else 1 - 2 * side) * float(coverage[j, i])
                light, total = light + share * image[j, i].astype(np.float64), total + share
        out[y, x] = light / total
    return out


def disc(size=16):
    """A disc with a soft edge."""
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.clip(size / 2 - 1.5 - np.hypot(x, y), 0, 1).astype(np.float32)


@pytest.mark.parametrize("side", [0.0, SIDE, 1 / 3])
def test_the_filter_is_the_coverage_weighted_mean_of_three_by_three(side):
    image = np.random.default_rng(0).gamma(0.5, 1.0, (16, 16, 3)).astype(np.float32)
    found = filter_pixels(image, disc(), side)
    assert np.allclose(found, reference(image, disc(), side), rtol=1e-5, atol=1e-6)
    assert (found >= 0).all()
    assert (found <= image.max() * (1 + 1e-6)).all()


def test_a_constant_stays_one_up_to_the_edge_and_what_is_outside_takes_no_part():
    image = np.where(disc()[..., None] > 0, np.float32(0.7), np.float32(1e6)) * np.ones(3, np.float32)
    found = filter_pixels(image, disc(), SIDE)
    assert np.allclose(found[disc() > 0], 0.7, rtol=1e-6)
    assert not found[disc() == 0].any()


def test_the_filter_inside_a_matte_moves_light_and_keeps_its_sum():
    image = np.zeros((9, 9, 1), np.float32)
    image[4, 5] = 1e7
    found = filter_pixels(image, np.ones((9, 9), np.float32), SIDE)
    assert np.isclose(found.sum(dtype=np.float64), 1e7, rtol=1e-6)
    assert np.isclose(found[4, 5, 0], 1e7 * (1 - 2 * SIDE) ** 2, rtol=1e-6)
    y, x = np.mgrid[:9, :9]
    for spread in ((y - 4) ** 2, (x - 5) ** 2):  # the knob is half the filter's variance, pixels^2
        assert np.isclose((spread * found[..., 0]).sum() / 1e7, 2 * SIDE, rtol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_the_filter_of_a_line_or_a_pixel(shape):
    image = np.random.default_rng(1).random((*shape, 3)).astype(np.float32)
    assert np.allclose(
        filter_pixels(image, np.ones(shape, np.float32), SIDE), reference(image, np.ones(shape), SIDE), rtol=1e-5
    )


def test_averaged_normals_are_known_by_their_length():
    gbuffer, _ = sphere((24, 24))
    inside = gbuffer.opacity > 0
    assert short_normals(gbuffer.normal.astype(np.float16), inside) == 0
    averaged = filter_pixels(gbuffer.normal, np.ones((24, 24), np.float32), 0.25)  # with the nothing around it
    assert not read_at_centres(short_normals(averaged, inside))
    unknown = np.full((24, 24, 3), np.nan)
    assert short_normals(unknown, inside) == short_normals(0 * gbuffer.normal, inside) == 0
    assert short_normals(gbuffer.normal, 0 > gbuffer.opacity) == 0


def test_relighting_averages_only_where_normals_are_of_pixel_centres():
    gbuffer, cam = sphere((24, 24), roughness=0.2, metallic=1.0)
    edge = replace(gbuffer, normal=filter_pixels(gbuffer.normal, np.ones((24, 24), np.float32), 0.25))
    for given, averaged in ((gbuffer, True), (edge, False)):
        points, found = (
            relight(
                given.base_color, given, cam, sky(), sky(8), RelightSettings.from_quality("draft", pixel_filter=side)
            )
            for side in (0.0, SIDE)
        )
        assert np.array_equal(points.diffuse, found.diffuse) != averaged or not points.diffuse.any()
        assert np.array_equal(points.specular, found.specular) != averaged
        assert np.array_equal(points.base_color, found.base_color)
        assert (found.radiance[gbuffer.opacity == 0] == 0).all()


def test_light_at_pixel_centres_comes_nearer_to_a_blackman_harris_filter():
    """A shiny ball, at eight by eight points a pixel under Cycles' default filter, against its pixel centres."""
    fine, coarse = (sphere(size, roughness=0.15, metallic=1.0)[0] for size in ((192, 192), (24, 24)))
    light, covered = shade(fine, sky(), camera((192, 192)), DRAFT, False).radiance, fine.opacity[..., None]
    seen = _blackman_harris(light * covered) / np.maximum(_blackman_harris(covered), 1e-6)
    points = shade(coarse, sky(), camera(), DRAFT, False).radiance
    whole = _blackman_harris(covered)[..., 0] > 0.99
    plain, filtered = (np.square(a - seen)[whole].mean() for a in (points, filter_pixels(points, coarse.opacity, SIDE)))
    assert filtered < 0.4 * plain


def _blackman_harris(image, width=3.0, fold=8):
    """[8 H, 8 W, C] at a pixel's points to [H, W, C] filtered at that width, pixels."""
    reach = 2 * fold
    at = (np.arange(-reach, reach) + 0.5) / fold / width + 0.5
    terms = (0.35875, -0.48829, 0.14128, -0.01168)
    weight = sum(a * np.cos(2 * np.pi * k * at) for k, a in enumerate(terms)) * ((at > 0) & (at < 1))
    weight /= weight.sum()
    for axis in (0, 1):
        count = image.shape[axis] // fold
        image = np.moveaxis(np.pad(image, [(reach, reach) if k == axis else (0, 0) for k in range(3)]), axis, 0)
        taps = enumerate(weight, fold // 2)
        image = sum(w * image[k : k + count * fold : fold] for k, w in taps)
        image = np.moveaxis(image, 0, axis)
    return image


def test_plan_says_whether_the_pixel_filter_is_applied_and_why():
    for short, settings, modelled, reason in (
        (0.0, RelightSettings(), True, "0.0 % of the first frame's normals"),
        (0.29, RelightSettings(), False, "29.0 % of the first frame's normals are averages: the G-buffer has been"),
        (None, RelightSettings(), True, "where normals are of unit length"),
        (0.0, RelightSettings(pixel_filter=0.0), False, "switched off"),
    ):
        found = {r.term: r for r in requirements(SceneFacts(short=short), settings)}["pixel filter"]
        assert found.modelled == modelled
        assert reason in found.reason


def test_a_filter_flatter_than_a_box_of_three_pixels_is_refused():
    with pytest.raises(JobError, match=r"`pixel_filter` cannot be 0\.4"):
        RelightSettings(pixel_filter=0.4)


def test_the_former_name_of_the_filter_is_refused_and_the_new_one_named():
    with pytest.raises(JobError, match=r"Relighting's `film` is now called `pixel_filter`.*Do: rename it"):
        RelightSettings.from_quality("standard", film=0.1)


def test_shade_does_not_filter():
    """`shade` has no plate to match: it returns radiance at pixel centres."""
    gbuffer, cam = sphere((12, 12))
    one, two = (shade(gbuffer, sky(), cam, replace(DRAFT, pixel_filter=side), False).radiance for side in (0.0, SIDE))
    assert np.array_equal(one, two)


def test_paint_under_even_light_is_not_blurred_again_and_light_is():
    rng = np.random.default_rng(1)
    paint, light = rng.uniform(0.02, 1, (16, 16, 3)).astype(np.float32), rng.gamma(1.0, 1.0, (16, 16, 1))
    nowhere, everywhere = np.zeros((16, 16), np.bool_), np.ones((16, 16), np.bool_)
    even = filter_light(paint * np.float32(0.7), paint, nowhere, disc(), SIDE)
    inside = disc() > 0
    assert np.allclose(even[inside], 0.7 * paint[inside], rtol=1e-5)
    image = (light * paint).astype(np.float32)
    grey = np.full_like(paint, 0.5)
    lit = (light * grey).astype(np.float32)
    assert np.allclose(
        filter_light(lit, grey, nowhere, disc(), SIDE), filter_pixels(lit, disc(), SIDE), rtol=1e-5, atol=1e-6
    )
    assert np.array_equal(filter_light(image, paint, everywhere, disc(), SIDE), filter_pixels(image, disc(), SIDE))
    black = filter_light(0 * image, 0 * paint, nowhere, disc(), SIDE)
    assert np.isfinite(black).all()
    assert not black.any()


def test_boundaries_are_at_bends_at_seams_of_metal_and_at_the_matte():
    normal, metallic = np.zeros((12, 12, 3), np.float32), np.zeros((12, 12), np.float32)
    normal[2:, :6], normal[2:, 6:] = (0, 0, 1), (0, 0.6, 0.8)
    metallic[8:, :3] = 1
    found = boundaries(normal, metallic)
    assert found[1:3].all()  # the matte's edge
    assert found[3:, 5:7].all()
    assert found[7:9, :4].all()
    assert not found[4:6, :4].any()
    assert not found[3:, 8:].any()
    assert not boundaries(normal[3:, :5], metallic[3:8, :5].repeat(2, 0)[:9]).any()
