"""When solvers stop, how work is shared among threads, and what is reported of a frame's consistency."""

from dataclasses import replace

import numpy as np
import pytest

from yesnt.temporal.adam import solve_adam
from yesnt.temporal.geometry import Geometry
from yesnt.temporal.newton import Limits, solve_newton
from yesnt.temporal.outliers import frame_consistency
from yesnt.temporal.solver import channel_problem, check_inputs
from yesnt.temporal.threads import frame_groups
from yesnt.temporal.tracks import ObservedFrame


def channel(problem):
    """One channel and its start."""
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    made = channel_problem(inputs, 0, problem.params)
    return made, made.observed.astype(np.float64)


@pytest.mark.parametrize("seed", [3, 12])
def test_the_solver_stops_at_the_first_proof_that_suffices(problem_drawn, seed):
    limits = Limits(1e-3, outer=60)
    problem, start = channel(problem_drawn(seed))
    state = solve_newton(problem, start.copy(), limits)
    assert 1 < state.outer < limits.outer
    assert state.gap <= limits.tolerance
    earlier = solve_newton(problem, start.copy(), replace(limits, outer=state.outer - 1))
    assert earlier.gap > limits.tolerance


def test_the_solver_goes_on_while_pixels_still_move(problem_drawn):
    problem, start = channel(problem_drawn(12))
    loose = solve_newton(problem, start.copy(), Limits(1e-1))
    still = solve_newton(problem, start.copy(), Limits(1e-1, step=1e-5))
    assert loose.step > 1e-5 >= still.step
    assert still.outer > loose.outer


def test_adam_certifies_after_every_block_of_steps(pattern):
    problem, start = channel(pattern(2, 12, 16))
    state = solve_adam(problem, start, Limits(1e-6, outer=3), every=5)
    assert state.outer == 15
    assert state.energy < solve_adam(problem, start, Limits(1e-6, outer=1), every=5).energy


def groups(counts, threads):
    """Edges for frames of these pixel counts."""
    empty = np.zeros(0)
    frames = np.cumsum([0, *counts]).astype(np.int64)
    return frame_groups(Geometry(frames, *[empty] * 6), threads).tolist()


def test_threads_share_the_pixels_and_not_the_frames():
    assert groups([10] * 8, 4) == [0, 2, 4, 6, 8]
    assert groups([10] * 10 + [50], 2) == [0, 8, 11]
    assert groups([50] + [10] * 10, 2) == [0, 4, 11]


def test_a_frame_of_one_pixel_keeps_all_frames_in_one_group():
    assert groups([10, 1, 10, 10], 4) == [0, 4]


def test_the_ratio_of_a_frame_compares_medians(pattern):
    problem = pattern(9, 40, 48, noise=0.04)
    observed = problem.observed.copy()
    observed[4] += 0.3

    def read(t):
        last = t + 1 == len(observed)
        flow, validity = (None, None) if last else (problem.flow[t], problem.validity[t])
        return ObservedFrame(observed[t][None], problem.matte[t], flow, validity)

    found = list(frame_consistency(read, len(observed)))
    ratios = np.array([frame.ratio for frame in found])
    assert np.argmax(ratios) == 4
    assert np.median(ratios) == pytest.approx(1, abs=0.15)
    assert found[4].downweighted > 0.9
