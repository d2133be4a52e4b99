"""A fit finds a small scene again, continues to the same bits, and starts from surfaces."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from tests.gaussians.scenes import random_field, view_at
from yesnt.core.errors import JobError
from yesnt.gaussians.densify import densify
from yesnt.gaussians.field import rotation_matrices
from yesnt.gaussians.fit import camera_of_step, fit, held_out_psnr
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.initial import discs, point_distance, rotations_to
from yesnt.gaussians.render import render
from yesnt.gaussians.settings import FitSettings
from yesnt.gaussians.targets import Target

EYES = [(2, 0, 0.4), (-1.2, 1.6, 0.3), (-1, -1.7, 0.5), (0.3, 1.9, -0.6), (1.4, -1.4, 0.8)]
SETTINGS = FitSettings(
    steps=120, count=600, most=640, half=0.2, every=45, split_from=0.2, split_until=0.5, check=40, position_rate=3e-4
)


def sphere(count: int = 1500) -> np.ndarray:
    """Evenly spread unit vectors."""
    k = np.arange(count) + 0.5
    angle, z = np.pi * (1 + 5**0.5) * k, 1 - 2 * k / count
    return np.stack([np.cos(angle) * np.sqrt(1 - z * z), np.sin(angle) * np.sqrt(1 - z * z), z], 1)


def pictures() -> list[Target]:
    """Views of a ball with a smooth pattern of radius 0.5, made of many small discs."""
    n = sphere()
    state = discs(0.5 * n, n, [], 1500, 0)
    shades = 1.2 * np.sin(4 * n[:, 2]) * np.cos(3 * n[:, 0] + 0.5)
    harmonics = np.repeat(shades[:, None, None], 3, 2).astype(np.float32)
    ball = replace(state, harmonics=harmonics, opacity_logits=np.full(1500, 3, np.float32))
    targets = []
    for eye in EYES:
        view = view_at(eye, (40, 40), 55.0)
        seen = render(ball, view)
        targets.append(Target.cropped(view, seen.color, seen.alpha, margin=3))
    return targets


TARGETS = pictures()


def begin() -> FitState:
    n = sphere()
    return FitState.of(discs(0.52 * n, n, TARGETS[:4], 600, 1), 1.0, 2 / 55)


def run(state: FitState, until: int = 120) -> list:
    looks = []
    for progress in fit(state, TARGETS[:4], TARGETS[4:], SETTINGS, frame=3):
        looks.append(progress)
        if progress.step >= until:
            break
    return looks


def test_a_fit_gains_on_a_camera_that_it_has_not_seen_and_keeps_its_limit() -> None:
    state = begin()
    before = [held_out_psnr(state, part, 0.05) for part in (TARGETS[:4], TARGETS[4:])]
    looks = run(state)
    assert looks[-1].done
    assert [look.step for look in looks] == [40, 80, 120]
    assert held_out_psnr(state, TARGETS[:4], 0.05) > before[0] + 2
    assert looks[-1].psnr == held_out_psnr(state, TARGETS[4:], 0.05) > before[1]
    assert 600 < state.count <= 640
    assert np.allclose(np.linalg.norm(state.gaussians.rotations, axis=1), 1, atol=1e-5)


def test_a_fit_that_was_interrupted_ends_with_the_same_bits_for_any_number_of_threads() -> None:
    ends, before = [], numba.get_num_threads()
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            state = begin()
            run(state, 40 * threads)
            again = FitState.from_arrays({k: v.copy() for k, v in state.to_arrays().items()})
            assert run(again)[-1].done
            ends.append({name: value.tobytes() for name, value in again.to_arrays().items()})
    finally:
        numba.set_num_threads(before)
    assert ends[0] == ends[1]


def test_a_fit_stops_early_once_its_quality_is_reached_and_not_before() -> None:
    for quality, steps in ((5.0, 40), (99.0, 120)):
        looks = list(fit(begin(), TARGETS[:4], TARGETS[4:], replace(SETTINGS, stop_psnr=quality)))
        assert looks[-1].step == steps


def test_every_camera_is_seen_once_a_round_in_an_order_of_seed_and_frame() -> None:
    orders = {(s, f): [camera_of_step(i, 7, s, f) for i in range(14)] for s in (0, 1) for f in (5, 6)}
    for order in orders.values():
        assert sorted(order[:7]) == sorted(order[7:]) == list(range(7))
    assert len({tuple(order) for order in orders.values()}) == 4


def test_splitting_keeps_the_middle_and_prunes_what_is_faint_or_unseen() -> None:
    state = FitState.of(random_field(6), 1.0, 0.01)
    state.values["opacity_logits"][:] = [2, -6, 2, 2, 2, 2]
    state.seen[:], state.screen[:] = [1, 1, 0, 1, 1, 1], [1, 0, 0, 9, 1, 1]
    state.height = 10.0
    middle = state.values["positions"][3].copy()
    densify(state, 5, 1.0)
    assert state.count == 5  # four were kept, and the one of the largest gradient was split
    halves = [row for row in state.values["positions"] if np.linalg.norm(row - middle) < 0.2]
    assert np.allclose(np.mean(halves, 0), middle, atol=1e-6)
    assert state.seen.sum() == 0


def test_few_wide_discs_survive_the_limit_of_their_width() -> None:
    n = sphere(40)
    state = FitState.of(discs(0.5 * n, n, TARGETS, 40, 0), 1.0, 0.01)
    state.seen[:] = 1
    assert np.exp(state.values["log_scales"].max()) > 0.08  # the limit of a field of thousands
    densify(state, 40, 0.0)
    assert state.count == 40
    state.seen[:] = 1
    state.values["log_scales"][:7] = np.log(0.9)
    densify(state, 40, 0.0)
    assert state.count == 33


def test_a_fit_that_has_lost_every_gaussian_says_why() -> None:
    state = FitState.of(random_field(6), 1.0, 0.01)
    state.values["opacity_logits"][:4] = -6
    state.step = 250
    with pytest.raises(JobError, match="lost all of its 6 Gaussians by step 250: 4 almost transparent, 6 in no pic"):
        densify(state, 6, 1.0)
    assert state.count == 6


def test_discs_lie_on_the_surface_with_its_normals_and_distance() -> None:
    n = sphere()
    field = discs(n, n, TARGETS, 400, 2)
    assert field.count == 400
    assert field.degree == 2
    thin = np.take_along_axis(field.axes, field.log_scales.argmin(1)[:, None, None], 2)[..., 0]
    assert np.allclose(np.abs((thin * field.positions).sum(1)), 1, atol=1e-4)
    assert np.isclose(point_distance(sphere(1000)), np.sqrt(4 * np.pi / 1000), rtol=0.35)
    assert np.allclose(rotation_matrices(rotations_to(n))[:, :, 2], n, atol=1e-6)
