"""The start of a frame between keyframes: limbs that moved by themselves are taken away and put where the hull is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gaussians.scenes import camera_at, shell
from yesnt.capture.hull import Hull, Silhouette, visual_hull
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.following import chosen, continued, joined, outside
from yesnt.gaussians.initial import discs
from yesnt.gaussians.records import View
from yesnt.gaussians.render import render
from yesnt.gaussians.settings import FitSettings
from yesnt.gaussians.targets import Target

BODY, LIMB = 0.3, 0.12
BEFORE, AFTER = np.array([0.42, 0.0, 0.0]), np.array([0.0, 0.0, 0.42])
SETTINGS = FitSettings(count=1200, degree=0)


def at(field: GaussianField, place: np.ndarray) -> GaussianField:
    return replace(field, positions=(field.positions + place).astype(np.float32))


def body_with_limb(place: np.ndarray) -> GaussianField:
    return joined(shell(600, BODY, 5.0), at(shell(200, LIMB, 5.0), place))


def seen(field: GaussianField) -> tuple[Hull, list[Target]]:
    """The hull and the pictures of a field, of cameras from all sides."""
    eyes = [(2 * np.cos(a), 2 * np.sin(a), h) for h in (-0.9, 0.1, 1.1) for a in 0.3 + np.arange(5) * 2 * np.pi / 5]
    cameras = [camera_at(eye, (64, 64), 76.0) for eye in eyes]
    pictures = [render(field, View.of(camera)) for camera in cameras]
    hull = visual_hull(
        [Silhouette(str(i), c, None, p.alpha) for i, (c, p) in enumerate(zip(cameras, pictures, strict=True))]
    )
    return hull, [Target.cropped(View.of(c), p.color, p.alpha) for c, p in zip(cameras, pictures, strict=True)]


def start_of(before: GaussianField, after: GaussianField) -> GaussianField:
    hull, targets = seen(after)
    points, normals = hull.points.astype(np.float64), hull.normals.astype(np.float64)
    return continued(before, points, normals, hull.spacing, targets, SETTINGS)


def near(field: GaussianField, place: np.ndarray, reach: float) -> int:
    return int((np.linalg.norm(field.positions - place, axis=1) < reach).sum())


def test_a_limb_that_moved_by_itself_is_put_where_it_is_now() -> None:
    start = start_of(body_with_limb(BEFORE), body_with_limb(AFTER))
    far = 1.12 * BEFORE
    assert near(body_with_limb(BEFORE), far, 0.13) > 50
    assert near(start, far, 0.13) == 0
    assert near(start, 1.12 * AFTER, 0.13) > 30


def test_a_subject_at_rest_keeps_its_gaussians_and_gets_few() -> None:
    field = body_with_limb(BEFORE)
    start = start_of(field, field)
    assert start.count < 1.05 * field.count
    assert near(start, np.zeros(3), 1.0) >= 0.98 * field.count


def test_the_mouth_of_a_bowl_stays_open() -> None:
    whole = shell(900, BODY, 5.0)
    bowl = chosen(whole, whole.positions[:, 2] < 0.02)
    hull, targets = seen(bowl)
    cover = discs(hull.points, hull.normals, targets, SETTINGS.count, 0)
    assert in_mouth(cover) > 100, "the hull closes the mouth"
    assert in_mouth(start_of(bowl, bowl)) < 6


def in_mouth(field: GaussianField) -> int:
    across = np.linalg.norm(field.positions[:, :2], axis=1)
    return int(((field.positions[:, 2] > -0.02) & (across < 0.7 * BODY)).sum())


def test_outside_is_beyond_the_surface_along_its_normal() -> None:
    points = np.stack(np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21), [0.0]), -1).reshape(-1, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    places = np.array([[0, 0, 0.3], [0, 0, 0.1], [0, 0, -0.3]])
    assert outside(places, points, normals, 0.2).tolist() == [True, False, False]


def test_a_following_frame_prunes_and_splits() -> None:
    settings = FitSettings().following()
    assert settings.every < settings.steps
    assert settings.split_from == 0
    assert settings.split_until == FitSettings().split_until


@pytest.mark.parametrize("half", [0.25, 1.0])
def test_a_following_frame_is_fitted_at_half_resolution_only_if_always(half: float) -> None:
    assert FitSettings(half=half).following().half == float(half == 1)
