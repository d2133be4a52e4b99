"""The evidence on a painted sphere whose pictures come from a sum in float64 that shares no kernel with yesnt."""

import re
from dataclasses import replace
from functools import lru_cache

import numba
import numpy as np
import pytest

from tests.decompose.evidence.scenes import RELIGHT, around, inputs, look_from, smooth_light
from yesnt.decompose.evidence import frame
from yesnt.decompose.evidence.frame import PLATE, measure_frame
from yesnt.decompose.evidence.settings import EvidenceSettings

SETTINGS = EvidenceSettings()
SIZE = 24


@lru_cache(maxsize=4)
def scene(count=8, strength=0.8, bands=None):
    """Inputs with `count` cameras and the painted materials."""
    more = {} if bands is None else {"bands": bands}
    return inputs(around(count), smooth_light(strength), SIZE, **more)


def measured(given, settings=SETTINGS):
    """The evidence, and where the matte is."""
    return measure_frame(given, RELIGHT, settings), given.surface.opacity > 0.5


def error(found, truth, inside):
    """RMSE of roughness and of metallic."""
    pair = zip(found.mean, (truth.roughness, truth.metallic), strict=True)
    return [float(np.sqrt(np.square(a[inside] - b[inside]).mean())) for a, b in pair]


def guess_error(given, truth, inside):
    surface = given.surface
    pair = ((surface.roughness, truth.roughness), (surface.metallic, truth.metallic))
    return [float(np.sqrt(np.square(a[inside] - b[inside]).mean())) for a, b in pair]


def test_eight_cameras_measure_what_the_model_cannot() -> None:
    given, truth = scene()
    found, inside = measured(given)
    roughness, metallic = error(found, truth, inside)
    first = guess_error(given, truth, inside)
    assert roughness < 0.75 * first[0]
    assert metallic < 0.6 * first[1]
    right = (found.mean[1] > 0.5) == (truth.metallic > 0.5)
    assert right[inside].mean() > 0.9
    assert found.left_out == {}
    assert found.views[inside].max() <= 9
    assert found.views[inside].mean() > 4
    assert (found.std <= 0.5).all()
    assert (found.mean >= 0).all()
    assert (found.mean <= 1).all()


def test_the_base_colour_by_all_views_is_the_paint_and_counts_on_metals() -> None:
    given, truth = scene()
    found, inside = measured(given)
    well = inside & (found.views >= 4)
    base, weight = found.base_views[..., :3], found.base_views[..., 3]
    assert np.sqrt(np.square(base - truth.base)[well].mean()) < 0.045, "each pixel has its own"
    assert weight[well & (truth.metallic > 0.5)].mean() > 0.8
    assert weight[well & (truth.metallic < 0.5)].mean() < 0.4


def test_more_cameras_tell_more() -> None:
    (few, truth), (many, _) = scene(4), scene(8)
    a, inside = measured(few)
    b, _ = measured(many)
    assert sum(error(b, truth, inside)) < sum(error(a, truth, inside))
    assert b.std[:, inside].mean() < a.std[:, inside].mean()


def test_the_result_does_not_depend_on_tiles_or_threads() -> None:
    given, _ = scene(4)
    whole, _ = measured(given)
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        tiled, _ = measured(given, EvidenceSettings(tile=64))
    finally:
        numba.set_num_threads(before)
    for name in ("mean", "std", "views"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(tiled, name))


def test_twice_the_light_and_twice_the_pictures_give_the_same_materials() -> None:
    from yesnt.relight.frame import prepare_capture

    given, _ = scene(4)
    env = smooth_light()
    bright = replace(
        given, plate=2 * given.plate, views=[replace(v, radiance=2 * v.radiance) for v in given.views],
        light=prepare_capture(env.turned((0, 0, 0), 1.0), RELIGHT),
    )  # fmt: skip
    np.testing.assert_allclose(measured(bright)[0].mean, measured(given)[0].mean, atol=2e-3)


def test_one_camera_and_uniform_light_leave_the_model_its_estimate() -> None:
    given, truth = scene(1, 0.0)
    found, inside = measured(given)
    alone = inside & (found.views == 0)
    assert alone.any(), "the camera sees one side only"
    np.testing.assert_array_equal(found.mean[0][alone], given.surface.roughness[alone])
    np.testing.assert_array_equal(found.std[1][alone], given.spread[1][alone])
    assert error(found, truth, inside)[0] < 1.1 * guess_error(given, truth, inside)[0]


def test_cameras_on_one_side_measure_that_side_and_leave_the_other_to_the_model() -> None:
    sides = around(9)
    given, truth = inputs(sides[sides[:, 0] > 0.25], smooth_light(0.8), SIZE)
    found, inside = measured(given)
    left = inside & (given.surface.normal[..., 0] < -0.75)
    assert left.any()
    assert (found.views[left] < 2).all()
    np.testing.assert_array_equal(found.mean[1][left], given.surface.metallic[left])
    right = inside & (given.surface.normal[..., 0] > 0.2)
    assert found.views[right].mean() > 2
    for wrong, guess in zip(error(found, truth, right), guess_error(given, truth, right), strict=True):
        assert wrong < guess


def test_a_capture_that_sees_nothing_of_the_plate_changes_nothing() -> None:
    given, _ = scene(4)
    behind = inputs([(0.1, 1, 0), (-0.1, 1, 0.1)], smooth_light(), SIZE)[0].views
    found, inside = measured(replace(given, views=behind))
    assert not found.views[inside].any()
    np.testing.assert_array_equal(found.mean[0], given.surface.roughness)
    none, _ = measured(replace(given, views=[]))
    np.testing.assert_array_equal(none.std, given.spread)


def test_a_camera_that_sees_only_the_rim_from_behind_changes_nothing(monkeypatch) -> None:
    azimuth = np.radians(-90 + 130)
    behind = np.array([[np.cos(azimuth), np.sin(azimuth), 0]])
    given, _ = inputs(np.concatenate([around(3), behind]), smooth_light(), 24)
    without, _ = measured(replace(given, views=given.views[:3]))
    np.testing.assert_array_equal(measured(given)[0].mean, without.mean)
    monkeypatch.setattr(frame, "LEAST_SIGHT", 0.0)
    used, _ = measured(given)
    assert (used.views > without.views).any(), "it does see points"
    assert (used.mean != without.mean).any()


def test_nan_pixels_of_a_camera_are_not_observed() -> None:
    given, _ = scene(4)
    radiance = given.views[0].radiance.copy()
    radiance[SIZE // 2 - 3 : SIZE // 2 + 3] = np.nan
    found, inside = measured(replace(given, views=[replace(given.views[0], radiance=radiance), *given.views[1:]]))
    whole, _ = measured(given)
    assert np.isfinite(found.mean).all()
    assert found.views[inside].sum() < whole.views[inside].sum()


def test_a_mirror_is_found_and_is_no_contradiction() -> None:
    given, truth = scene(6, 0.8, ((0.05, 1.0, (0.9, 0.9, 0.9)),) * 2)
    found, inside = measured(given)
    assert np.isfinite(found.std).all()
    roughness, metallic = error(found, truth, inside)
    first = guess_error(given, truth, inside)
    assert roughness < 0.5 * first[0]
    assert metallic < 0.3 * first[1]
    assert found.left_out == {}, "what a mirror shows differs from camera to camera"


def test_a_black_surface_keeps_its_roughness() -> None:
    """A black dielectric is a metal of base colour 0.04 as well: they look the same, and the prior has to choose."""
    given, truth = scene(6, 0.8, ((0.8, 0.0, (0.0, 0.0, 0.0)),) * 2)
    found, inside = measured(given)
    assert np.isfinite(found.mean).all()
    roughness, metallic = error(found, truth, inside)
    assert roughness < 0.6 * guess_error(given, truth, inside)[0]
    assert metallic < 0.5


def test_a_black_capture_light_is_survived() -> None:
    from yesnt.relight import EnvMap
    from yesnt.relight.frame import prepare_capture

    given, _ = scene(4)
    dark = prepare_capture(EnvMap.from_array(np.zeros((8, 16, 3))), RELIGHT)
    found, _ = measured(replace(given, light=dark))
    assert np.isfinite(found.mean).all()


def with_view(given, number, **changes):
    views = list(given.views)
    views[number] = replace(views[number], **changes)
    return replace(given, views=views)


def test_a_camera_of_twice_the_gain_is_named_and_left_out() -> None:
    given, truth = scene()
    clean, inside = measured(given)
    found, _ = measured(with_view(given, 3, radiance=2 * given.views[3].radiance))
    assert list(found.left_out) == ["c03"]
    assert re.fullmatch(r"its picture is (1\.9|2\.0). times as bright as the others' .*", found.left_out["c03"])
    assert found.gains["c03"] == pytest.approx(2, rel=0.1)
    assert sum(error(found, truth, inside)) < 1.15 * sum(error(clean, truth, inside))


def test_a_black_picture_is_named_and_left_out_beside_another_that_is_wrong() -> None:
    given, _ = scene()
    black = with_view(given, 2, radiance=0 * given.views[2].radiance)
    found, _ = measured(black)
    assert found.left_out == {"c02": "its picture is black where the others see the subject"}
    both, _ = measured(with_view(black, 5, radiance=2 * given.views[5].radiance))
    assert list(both.left_out) == ["c02", "c05"], "the worst first"


def test_a_wrong_pose_is_named_and_left_out() -> None:
    given, _ = scene()
    camera = look_from(around(8)[1] + [0, 0, 0], SIZE, 4.0)
    pose = camera.poses[7].copy()
    pose[:3, 3] += 0.6 * pose[:3, 0]  # a third of the subject aside
    moved = replace(camera, poses={7: pose})
    found, _ = measured(with_view(given, 1, camera=moved))
    assert list(found.left_out) == ["c01"]
    assert "wrong pose" in found.left_out["c01"]
    matte = np.ones_like(given.views[5].matte)  # no matte at all
    assert "% of what the proxy shows" in measured(with_view(given, 5, matte=matte))[0].left_out["c05"]
    blind = replace(camera, poses={7: camera.poses[7] @ np.diag([1.0, -1, -1, 1])})
    assert measured(with_view(given, 1, camera=blind))[0].left_out["c01"] == "it does not see the subject"


def test_a_plate_of_another_exposure_is_named_too() -> None:
    given, _ = scene()
    found, _ = measured(replace(given, plate=2 * given.plate))
    assert list(found.left_out) == [PLATE]


def test_fitting_one_pixel_of_four_changes_little() -> None:
    given, truth = scene()
    (every, inside), (some, _) = measured(given, EvidenceSettings(step=1)), measured(given)
    assert sum(error(some, truth, inside)) < 1.15 * sum(error(every, truth, inside))


def test_gains_of_cameras_and_a_wrong_map_are_corrected() -> None:
    """Cameras off by 8 % and a map off by 20 % cost less where both are unknowns of the fit."""
    from yesnt.decompose.evidence.nuisances import corrected_map
    from yesnt.relight.frame import prepare_capture

    given, truth = scene()
    gains = np.exp(0.08 * np.random.default_rng(0).normal(size=(8, 3)))
    views = [replace(v, radiance=(v.radiance * g).astype(np.float32)) for v, g in zip(given.views, gains, strict=True)]
    wrong = corrected_map(smooth_light(), np.array([0, 0.3, 0, 0.3, 0, 0, 0.2, 0, 0]))
    spoilt = replace(given, views=views, light=prepare_capture(wrong, RELIGHT))
    corrected, inside = measured(spoilt)
    as_given, _ = measured(spoilt, EvidenceSettings(gain_error=0, light_error=0))
    assert sum(error(corrected, truth, inside)) < 0.9 * sum(error(as_given, truth, inside))
    assert corrected.light[0] < -0.05, "the map was too bright along +Y"
    assert as_given.light == ()


def test_z_that_contradicts_the_proxy_is_taken_from_it() -> None:
    """2 % of 4 m are a twenty-fifth of the subject: cameras to the side would see other points."""
    given, truth = scene()
    surface = given.surface
    far = replace(surface, z=np.where(surface.opacity > 0, 1.02 * surface.z, surface.z).astype(np.float32))
    found, inside = measured(replace(given, surface=far))
    clean, _ = measured(given)
    assert found.moved > 0.9 * inside.sum()
    assert clean.moved < 0.05 * inside.sum()
    assert found.views[inside].mean() > 0.8 * clean.views[inside].mean()
    assert sum(error(found, truth, inside)) < 1.2 * sum(error(clean, truth, inside))
    lost = replace(surface, z=np.where(surface.opacity > 0, surface.z + 1, surface.z).astype(np.float32))
    assert not measured(replace(given, surface=lost))[0].moved, "another part of the subject is no better"


def test_a_metal_is_not_smeared_into_a_dielectric_of_the_same_colour() -> None:
    bands = ((0.85, 0.0, (0.6, 0.6, 0.6)), (0.35, 1.0, (0.62, 0.62, 0.62)))
    given, truth = scene(bands=bands)
    inside, wrong = given.surface.opacity > 0.5, []
    beside = inside & (np.abs(np.arange(SIZE) - (SIZE - 1) / 2) < 3)
    metal = given.plate[inside & (truth.metallic > 0.5)].mean() / given.plate[inside & (truth.metallic < 0.5)].mean()
    assert 0.9 < metal < 1.1, "of one colour in the plate"
    for settings in (SETTINGS, replace(SETTINGS, contrary=1e9)):
        found, _ = measured(given, settings)
        wrong.append(np.sqrt(np.square(found.mean[0] - truth.roughness)[beside].mean()))
    assert wrong[0] < 0.85 * wrong[1], "the disagreement of likelihoods is ignored"
