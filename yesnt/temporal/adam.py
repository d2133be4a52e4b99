"""The paper's solver for comparison: Adam with default parameters on all pixels (Implementation Details)."""

from __future__ import annotations

import numpy as np

from yesnt.temporal.newton import Array, Limits, NewtonSolver, Problem, State

DEFAULT_RATE = 1e-3
"""Default learning rate of Adam, which the paper uses; too small for this energy, see docs/temporal.md."""


def solve_adam(problem: Problem, start: Array, limits: Limits, rate: float = DEFAULT_RATE, every: int = 10) -> State:
    """Minimises F with Adam (Kingma and Ba 2015, algorithm 1: beta 0.9 and 0.999, epsilon 1e-8).

    Args:
        problem: energy of one channel.
        start: [N] initial value.
        limits: `outer` counts blocks of `every` steps; the gap is certified after each.
        rate: constant learning rate.
        every: steps between two certificates, which the paper's solver does not compute.

    Returns:
        The state of lowest energy among the certified ones.
    """
    solver = NewtonSolver(problem)
    x, mean, square = start.copy(), np.zeros_like(start), np.zeros_like(start)
    best = State(x=start.copy(), energy=solver.evaluate(x), bound=-np.inf)
    for step in range(1, limits.outer * every + 1):
        mean += 0.1 * (solver.gradient - mean)
        square += 0.001 * (solver.gradient**2 - square)
        x -= rate * (mean / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
        energy = solver.evaluate(x)
        if step % every == 0:
            solver.set_exact_duals(x)
            if solver.widen_box(x):
                best.bound = -np.inf
            best.bound = max(best.bound, solver.bound(x))
            best.step = float(np.max(np.abs(x - best.x), initial=0.0))
            best.outer = step
            if energy < best.energy:
                best.x, best.energy = x.copy(), energy
            if best.gap <= limits.tolerance:
                break
    return best
