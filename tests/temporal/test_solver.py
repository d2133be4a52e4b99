"""The solver: the minimum is right, the certificate is true, the bits are the same for any number of threads."""

import numpy as np
import pytest

from yesnt.temporal import EnergyParams, energy, solve
from yesnt.temporal.newton import Limits, NewtonSolver, Problem
from yesnt.temporal.solver import channel_problem, check_inputs

UNCERTAIN = 1e-8
"""Relative rounding of the energies that are compared."""


@pytest.mark.parametrize("seed", range(30))
def test_minimum_and_certificate_against_a_long_float64_run(problem_drawn, minimiser, seed):
    problem = problem_drawn(seed)
    solution = solve(*problem.arguments)
    independent = minimiser(problem)
    assert independent.energy(solution.value[problem.matte].astype(np.float64)) == pytest.approx(
        solution.stats.energy, rel=1e-5, abs=1e-9
    )
    starts = (solution.value[problem.matte], problem.observed[problem.matte])
    best = min(independent.minimum(start) for start in starts)
    gap = (solution.stats.energy - best) / best if best > 1e-12 else solution.stats.energy - best
    assert gap <= 1e-4
    assert solution.stats.gap >= gap - UNCERTAIN
    assert solution.stats.converged


@pytest.mark.parametrize("seed", [3, 4, 6, 19, 33])
def test_the_bound_is_below_the_minimum_for_any_duals_and_any_point(problem_drawn, minimiser, seed):
    problem = problem_drawn(seed)
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    solver = NewtonSolver(channel_problem(inputs, 0, problem.params))
    best = minimiser(problem).minimum(solve(*problem.arguments).value[problem.matte])
    rng, count = np.random.default_rng(seed), inputs.geometry.pixels
    for scale in (0.0, 0.1, 1.0):
        angle, radius = rng.uniform(0, 2 * np.pi, count), scale * np.sqrt(rng.random(count))
        solver.duals.qx[:], solver.duals.qy[:] = radius * np.cos(angle), radius * np.sin(angle)
        assert solver.bound(rng.normal(0.5, scale, count)) <= best * (1 + 1e-9)


def test_weak_duality_is_tight_at_the_minimum(pattern):
    stats = solve(*pattern(6, 30, 40).arguments, tolerance=1e-6).stats
    assert stats.converged
    assert stats.gap <= 1e-6


@pytest.mark.parametrize("threads", [2, 3, 9])
def test_bits_do_not_depend_on_threads(pattern, monkeypatch, threads):
    problem = pattern(9, 40, 50)
    one = solve(*problem.arguments).value
    monkeypatch.setattr("yesnt.temporal.threads.PIXELS_PER_THREAD", 1)
    monkeypatch.setattr("yesnt.temporal.threads.get_num_threads", lambda: threads)
    np.testing.assert_array_equal(solve(*problem.arguments).value, one)


def test_material_gets_closer_to_the_truth_and_flickers_less(pattern):
    problem = pattern(8, 60, 80)
    value = solve(*problem.arguments).value

    def rmse(x):
        return np.sqrt(np.mean((x - problem.truth)[problem.matte] ** 2))

    assert rmse(value) < 0.4 * rmse(problem.observed)


def test_torch_in_torch_out(pattern):
    torch = pytest.importorskip("torch")
    problem = pattern(3, 20, 24)
    tensors = [torch.from_numpy(np.ascontiguousarray(a)) for a in problem.arguments[:4]]
    solution = solve(*tensors, problem.params, torch.from_numpy(problem.matte))
    assert isinstance(solution.value, torch.Tensor)
    np.testing.assert_array_equal(solution.value.numpy(), solve(*problem.arguments).value)
    assert energy(solution.value, *tensors, problem.params, torch.from_numpy(problem.matte)) == pytest.approx(
        solution.stats.energy, rel=1e-5
    )


def test_channels_share_the_warps_and_are_solved_as_if_alone(pattern):
    problem = pattern(4, 24, 30)
    other = 1 - problem.observed[:, :, ::-1].copy()
    both = solve(np.stack([problem.observed, other]), *problem.arguments[1:])
    assert both.value.shape == (2, *problem.observed.shape)
    np.testing.assert_array_equal(both.value[0], solve(*problem.arguments).value)
    np.testing.assert_array_equal(both.value[1], solve(other, *problem.arguments[1:]).value)


def test_outside_the_matte_the_observation_stays(pattern):
    problem = pattern(3, 20, 24)
    observed = np.where(problem.matte, problem.observed, np.nan).astype(np.float32)
    value = solve(observed, *problem.arguments[1:]).value
    np.testing.assert_array_equal(np.isnan(value), ~problem.matte)


def test_adam_comes_down_but_not_to_the_minimum(pattern):
    problem = pattern(4, 24, 30)
    exact, adam = solve(*problem.arguments), solve(*problem.arguments, method="adam")
    assert exact.stats.energy < adam.stats.energy < 1.5 * exact.stats.energy
    assert not adam.stats.converged


def test_every_step_lowers_the_energy(problem_drawn):
    problem = problem_drawn(12)
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    channel = channel_problem(inputs, 0, problem.params)
    energies = []
    for outer in (1, 2, 4, 8, 16):
        from yesnt.temporal.newton import solve_newton

        state = solve_newton(channel, channel.observed.astype(np.float64), Limits(1e-12, outer=outer))
        energies.append(state.energy)
    assert energies == sorted(energies, reverse=True)


def test_problem_reports_its_stiffness():
    geometry_free = Problem(None, None, None, EnergyParams(lambda1=1.0, eps=0.1, lambda2=5.0))
    assert geometry_free.stiffness == pytest.approx(120.0)


def test_half_floats_of_the_store_are_taken(pattern):
    problem = pattern(3, 20, 24)
    halves = [a.astype(np.float16) for a in problem.arguments[:4]]
    wide = [a.astype(np.float32) for a in halves]
    value = solve(*halves, problem.params, problem.matte).value
    assert value.dtype == np.float32
    np.testing.assert_array_equal(value, solve(*wide, problem.params, problem.matte).value)
