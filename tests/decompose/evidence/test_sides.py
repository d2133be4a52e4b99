"""Materials at points that the delivered view does not show, on the painted sphere, by cameras behind it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from tests.decompose.evidence.scenes import RELIGHT, around, inputs, paint, smooth_light
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.evidence.sides import Cameras, SurfacePoints, measure_points

SETTINGS = EvidenceSettings()


@lru_cache(maxsize=2)
def scene():
    """Cameras behind the sphere, the points of its back, and their true materials."""
    directions = around(8) * [1, -1, 1]
    given, _ = inputs(directions, smooth_light(), 32)
    proxy = given.proxy
    back = np.flatnonzero(proxy.vertices[:, 1] > 0.2)
    number = np.full(len(proxy.vertices), -1)
    number[back] = np.arange(len(back))
    edges = number[np.concatenate([proxy.faces[:, [0, 1]], proxy.faces[:, [1, 2]], proxy.faces[:, [2, 0]]])]
    prior = np.broadcast_to(np.float32([0.5, 0.3]), (len(back), 2)).copy()
    at = proxy.vertices[back]
    points = SurfacePoints(at, at / np.linalg.norm(at, axis=1, keepdims=True), prior, edges[(edges >= 0).all(axis=1)])
    return points, Cameras(given.views, proxy, given.light), paint(at.astype(float))


def test_cameras_behind_the_subject_measure_its_back() -> None:
    points, cameras, truth = scene()
    found, known = measure_points(points, cameras, RELIGHT, SETTINGS)
    inner = known & (points.position[:, 1] > 0.5) & (np.abs(points.position[:, 0] * 2 % 1 - 0.5) < 0.35)
    assert known.mean() > 0.9
    assert np.sqrt(np.square(found[inner, :3] - truth.base[inner]).mean()) < 0.05
    assert np.abs(found[inner, 3] - truth.roughness[inner]).mean() < 0.15
    right = (found[inner, 4] > 0.5) == (truth.metallic[inner] > 0.5)
    assert right.mean() > 0.95


def test_where_no_camera_looks_nothing_is_known_and_with_one_camera_the_prior_stands() -> None:
    points, cameras, truth = scene()
    nothing, known = measure_points(points, replace(cameras, views=[]), RELIGHT, SETTINGS)
    assert not known.any()
    assert not nothing.any()
    found, known = measure_points(points, replace(cameras, views=cameras.views[:1]), RELIGHT, SETTINGS)
    assert 0.1 < known.mean() < 0.9
    np.testing.assert_allclose(found[known, 3:], points.prior[known])
    plain = known & (truth.metallic == 0) & (points.position[:, 1] > 0.6)
    assert np.abs(found[plain, :3] - truth.base[plain]).mean() < 0.25


def test_the_result_does_not_depend_on_tiles() -> None:
    points, cameras, _ = scene()
    whole, tiled = (measure_points(points, cameras, RELIGHT, EvidenceSettings(tile=t))[0] for t in (4096, 64))
    np.testing.assert_array_equal(whole, tiled)
