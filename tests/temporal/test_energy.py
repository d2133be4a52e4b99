"""The energy against the plain reference, its gradient against differences, the warp against what it must do."""

import numpy as np
import pytest

from yesnt.temporal import energy, linear_system, reference
from yesnt.temporal.newton import NewtonSolver
from yesnt.temporal.solver import channel_problem, check_inputs


def solver_of(problem):
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    return NewtonSolver(channel_problem(inputs, 0, problem.params)), inputs


@pytest.mark.parametrize("seed", range(30))
def test_energy_agrees_with_the_float64_reference(problem_drawn, seed):
    problem = problem_drawn(seed)
    x = np.random.default_rng(seed + 100).normal(0.5, 0.5, problem.observed.shape).astype(np.float32)
    assert energy(x, *problem.arguments) == pytest.approx(problem.reference_energy(x), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_gradient_agrees_with_finite_differences(problem_drawn, seed):
    problem = problem_drawn(seed)
    solver, inputs = solver_of(problem)
    rng = np.random.default_rng(seed)
    x = rng.normal(0.5, 0.3, inputs.geometry.pixels)
    for _ in range(3):
        direction, step = rng.standard_normal(len(x)), 1e-7
        solver.evaluate(x)
        slope = float(solver.gradient @ direction)
        difference = (solver.evaluate(x + step * direction) - solver.evaluate(x - step * direction)) / (2 * step)
        assert slope == pytest.approx(difference, rel=1e-4, abs=1e-6)


def test_linear_operator_is_symmetric_and_its_diagonal_is_exact(problem_drawn):
    problem = problem_drawn(4)
    solver, inputs = solver_of(problem)
    rng, count = np.random.default_rng(0), inputs.geometry.pixels
    solver.evaluate(rng.random(count))
    solver.duals.qx[:], solver.duals.qy[:] = rng.uniform(-0.7, 0.7, (2, count))
    solver.newton_direction(rng.random(count), 0.1, 1)

    def product(v):
        out = np.zeros_like(v)
        solver.run(linear_system.apply, v, out, solver.per_frame, inputs.geometry, solver.matrix)
        return out

    kind = solver.z.dtype
    for _ in range(5):
        v, w = rng.standard_normal((2, count)).astype(kind)
        assert v @ product(w) == pytest.approx(w @ product(v), rel=1e-4)
        assert v @ product(v) >= 0
    for p in rng.integers(0, count, 20):
        unit = np.zeros(count, kind)
        unit[p] = 1
        assert product(unit)[p] * solver.cg.inverse[p] == pytest.approx(1, rel=1e-5)


def test_terms_of_a_constant_field_are_only_the_rounding_of_the_total_variation(pattern):
    problem = pattern(4, 20, 24)
    x = np.full(problem.observed.shape, 0.3, np.float32)
    problem = problem.changed(observed=x)
    expected = problem.params.lambda1 * problem.params.eps * problem.matte.sum()
    assert energy(x, *problem.arguments) == pytest.approx(expected, rel=1e-9)


def test_warp_moves_a_picture_by_the_flow():
    rng = np.random.default_rng(0)
    image = rng.random((9, 11))
    flow = np.zeros((9, 11, 2))
    flow[..., 0], flow[..., 1] = 2.0, 1.0
    warped, valid = reference.warp(image, flow, np.ones((9, 11), bool))
    np.testing.assert_allclose(warped[:-1, :-2], image[1:, 2:], atol=1e-12)
    assert valid[:-1, :-2].all()
    assert not valid[-1].any()
    assert not valid[:, -2:].any()


def test_warp_renormalises_over_the_matte_and_needs_half_of_the_weight():
    image, matte = np.array([[1.0, 9.0, 5.0]]), np.array([[True, False, True]])
    for fraction, value, good in ((0.25, 1.0, True), (0.5, 1.0, True), (0.75, 0.0, False)):
        warped, valid = reference.warp(image, np.full((1, 3, 2), (fraction, 0.0)), matte)
        assert valid[0, 0] == good
        assert warped[0, 0] == value


def test_energy_adds_up_over_channels(pattern):
    problem = pattern(3, 16, 18)
    other = problem.observed[::-1].copy()
    x = np.clip(problem.observed, 0.2, 0.8)
    both = energy(np.stack([x, x]), np.stack([problem.observed, other]), *problem.arguments[1:])
    each = [energy(x, observed, *problem.arguments[1:]) for observed in (problem.observed, other)]
    assert both == pytest.approx(sum(each), rel=1e-12)
