"""Mattes from pictures: laws of the kernels, and comparison with the truth of pictures that are made here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.capture.balls import around_balls, ring, silhouettes
from yesnt.capture.consistent import Support, support_of
from yesnt.capture.matting import (
    Background,
    changed,
    clean_background,
    combined,
    display_levels,
    median_background,
    refined,
    soft_edges,
)
from yesnt.capture.person import View, person_probability
from yesnt.capture.reduced import enlarged_image, reduced_camera, reduced_image

HEIGHT, WIDTH = 60, 80


def wall():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([0.3 + 0.1 * np.sin(x / 5), 0.3 + 0.1 * np.cos(y / 4), 0.35 + 0 * x], -1).astype(np.float32)


def body(left=30):
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[15:45, left : left + 20] = True
    return inside


def photographed(inside, light=1.0, seed=0, noise=0.004):
    shown = np.where(inside[..., None], np.float32([0.5, 0.2, 0.1]), wall()) * light
    return (shown + noise * np.random.default_rng(seed).normal(size=shown.shape)).astype(np.float32)


def agreement(matte, truth):
    return ((matte > 0.5) & truth).sum() / ((matte > 0.5) | truth).sum()


def test_what_differs_from_the_clean_plate_is_the_subject_whatever_the_light_does() -> None:
    background = clean_background(wall())
    for light in (0.9, 1.0, 1.1):
        picture = photographed(body(), light)
        chance = changed(picture, background)
        assert agreement(refined(display_levels(picture), chance), body()) > 0.97
    empty = changed(photographed(0 * body() > 0), background)
    assert (empty > 0.5).mean() < 0.001, "noise is not a subject"


def test_a_light_of_another_colour_is_not_the_subject() -> None:
    picture, background = photographed(body()), clean_background(wall())
    lit = changed(picture * np.float32([1.3, 1.0, 0.8]), background)
    assert np.abs(lit - changed(picture, background))[body()].max() < 0.01
    assert (lit[:10] > 0.5).mean() < 0.001


def test_a_shadow_is_not_the_subject() -> None:
    picture = photographed(0 * body() > 0)
    picture[10:30, 10:40] *= 0.65
    assert (changed(picture, clean_background(wall())) > 0.5).mean() < 0.001


def test_the_median_of_a_subject_that_passes_is_the_background() -> None:
    samples = np.stack([photographed(body(left), seed=left) for left in (0, 10, 20, 30, 40, 50, 60)])
    found = median_background(samples)
    assert found.known.all()
    assert np.abs(found.color - wall()).max() < 0.02
    assert agreement(refined(display_levels(samples[3]), changed(samples[3], found)), body(30)) > 0.97


def test_samples_with_a_person_do_not_count_and_what_is_always_hidden_is_unknown() -> None:
    samples = np.stack([photographed(body(left), seed=left) for left in (28, 30, 30, 30, 32)])
    person = np.stack([body(left) for left in (28, 30, 30, 30, 32)]).astype(np.float32)
    found = median_background(samples, person)
    assert not found.known[20:40, 33:47].any()
    assert found.known[:10].all()
    chance = changed(samples[1], found)
    assert (chance[20:40, 33:47] == 0.5).all(), "where the background is unknown a picture tells nothing"
    assert agreement(refined(display_levels(samples[1]), combined(chance, person[1])), body(30)) > 0.95


def test_damaged_pixels_tell_nothing() -> None:
    picture = photographed(body())
    picture[5, 5] = np.nan
    chance = changed(picture, clean_background(wall()))
    assert chance[5, 5] == 0.5
    assert np.isfinite(chance).all()
    unknown = Background(wall(), np.zeros((HEIGHT, WIDTH), np.float32), np.zeros((HEIGHT, WIDTH), bool))
    assert (changed(picture, unknown) == 0.5).all()


def test_both_must_speak_against_a_pixel_to_lose_it() -> None:
    values = np.float32([0.02, 0.5, 0.98])
    change, person = np.meshgrid(values, values)
    both = combined(change.astype(np.float32), person.astype(np.float32))
    assert both[1, 1] == pytest.approx(0.5)
    assert both[0, 2] == pytest.approx(0.5, abs=1e-6)
    assert both[2, 2] > 0.99
    assert both[0, 0] < 0.01


def test_edges_lie_where_the_picture_has_them() -> None:
    picture = photographed(body(), noise=0)
    blurred = np.clip(0.5 + (0.5 - np.abs(np.mgrid[:HEIGHT, :WIDTH][1] - 40.5) / 24), 0, 1).astype(np.float32)
    blurred[:13], blurred[47:] = 0, 0
    assert agreement(refined(display_levels(picture), blurred), body()) > agreement(blurred, body()) + 0.1


def test_the_same_picture_gives_the_same_bytes() -> None:
    picture = photographed(body())
    chance = changed(picture, clean_background(wall()))
    first = refined(display_levels(picture), chance)
    for _ in range(3):
        assert refined(display_levels(picture), chance).tobytes() == first.tobytes()


def test_reduced_pictures_and_cameras_show_the_same_place() -> None:
    (view,) = silhouettes([(1, 0.2, 0.1)], 96)
    small, camera = reduced_image(view.matte, 3), reduced_camera(view.camera, view.pose, 3)
    assert small.shape == (camera.height, camera.width) == (32, 32)
    point = np.array([[0.2, -0.3, 0.4]])
    x, y, _ = view.camera.project(point, view.pose)[0]
    assert camera.project(point, view.pose)[0][:2] == pytest.approx([x / 3, y / 3], rel=1e-6)
    assert reduced_image(view.matte[:95, :94], 3).shape == (31, 31)
    large = enlarged_image(small, 3, (97, 98))
    assert large.shape == (98, 97)
    soft = soft_edges(display_levels(np.dstack([view.matte] * 3)), large[:96, :96], 3)
    assert agreement(soft, view.matte > 0.5) > 0.98


@pytest.fixture(scope="module")
def views():
    return silhouettes(around_balls(8), 80, (((0, 0, 0), 0.5), ((0.6, 0.1, 0.2), 0.25)))


def changed_view(views, number, matte):
    return [replace(view, matte=matte) if n == number else view for n, view in enumerate(views)]


def test_good_mattes_are_kept_whole(views) -> None:
    for view, support in zip(views, support_of(views), strict=True):
        assert (support.kept[view.matte > 0] > 0.99).all()


def test_what_no_other_camera_supports_is_removed(views) -> None:
    matte = views[1].matte.copy()
    matte[2:14, 2:14] = 1
    support = support_of(changed_view(views, 1, matte))[1]
    assert support.applied(matte)[3:12, 3:12].max() == 0
    assert (support.kept[views[1].matte > 0.5] > 0.99).all()


def test_a_part_that_one_camera_missed_stays_in_the_others_and_returns_to_it(views) -> None:
    matte = views[1].matte.copy()
    missed = np.zeros_like(matte, bool)
    missed[:36] = matte[:36] > 0.99
    matte[missed] = 0.4  # the camera is not sure
    supports = support_of(changed_view(views, 1, matte))
    for view, support in zip(views, supports, strict=True):
        assert (support.kept[view.matte > 0.5] > 0.9).all(), "no camera loses a limb that another has missed"
    assert (supports[1].applied(matte)[missed] > 0.5).mean() > 0.9
    certain = np.where(missed, 0.0, matte)
    assert (supports[1].applied(certain.astype(np.float32))[missed] < 0.5).all(), "what is certain is not filled"


def test_one_of_three_others_may_have_missed_a_part() -> None:
    few = silhouettes(ring(5), 80, (((0, 0, 0), 0.5), ((0.6, 0.1, 0.2), 0.25)))
    supports = support_of(
        changed_view(few, 1, np.where(np.mgrid[:80, :80][0] < 38, 0, few[1].matte).astype(np.float32))
    )
    for number in (0, 2, 3, 4):
        assert (supports[number].kept[few[number].matte > 0.5] > 0.9).all()


def test_one_camera_or_none_that_sees_anything_changes_nothing(views) -> None:
    (alone,) = support_of(views[:1])
    assert (alone.kept == 1).all()
    for support in support_of([replace(view, matte=0 * view.matte) for view in views]):
        assert (support.kept == 1).all()


def test_support_without_others_leaves_the_probability_as_it_is() -> None:
    chance = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    assert Support(np.ones((3, 4), np.float32), np.zeros((3, 4), np.float32)).applied(chance) == pytest.approx(chance)


def test_a_body_is_covered_where_the_model_sees_it_however_the_camera_is_turned(monkeypatch, tmp_path) -> None:
    """Models that see a bright square stand in for MediaPipe's, in the form of their outputs."""
    from yesnt.capture import person

    monkeypatch.setattr(person, "_run", run_like_blazepose)
    models = person.Models(tmp_path / "detector", tmp_path / "body")
    picture = np.full((200, 120, 3), 0.05, np.float32)
    picture[80:120, 50:70] = 0.9
    upright = person_probability(picture, View((0.0, -1.0), (60.0, 100.0)), models)
    assert agreement(upright, picture[..., 0] > 0.5) > 0.8
    on_its_side = np.ascontiguousarray(np.rot90(picture))
    turned = person_probability(on_its_side, View((-1.0, 0.0), (100.0, 60.0)), models)
    assert agreement(np.rot90(turned, -1), picture[..., 0] > 0.5) > 0.8
    assert person_probability(0 * picture + 0.05, View((0.0, -1.0), (60.0, 100.0)), models).max() == 0


def run_like_blazepose(path, picture):
    """Boxes and scores of 2254 anchors, or presence and coverage, from where a picture is bright."""
    from yesnt.capture.person import _anchors

    if path.name == "body":
        bright = picture.mean(-1) > 0.5
        assert not bright.any() or bright.sum(0).max() > bright.sum(1).max(), "the body stands upright"
        return [np.zeros(195), np.float32([1.0]), np.where(bright, 9.0, -9.0)[..., None], None, None]
    boxes, scores = np.zeros((2254, 12), np.float32), np.full((2254, 1), -50, np.float32)
    y, x = np.nonzero(picture.mean(-1) > 0)
    if len(y):
        hips = np.array([x.mean(), y.mean()])
        anchor = int(np.argmin(np.linalg.norm(224 * _anchors(224) - hips, axis=1)))
        reach = hips - [0, np.ptp(y) + 1]
        boxes[anchor, 4:8] = np.concatenate([hips, reach]) - np.tile(224 * _anchors(224)[anchor], 2)
        scores[anchor] = 5
    return [boxes, scores]
