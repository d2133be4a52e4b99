"""The default solver: primal-dual Newton steps, each solved by preconditioned conjugate gradients on matte pixels.

A step from q = 0, u = 0 is iteratively reweighted least squares (lagged diffusivity), which never raises F; once the
duals are warm the steps are those of Chan, Golub and Mulet (1999), which converge as Newton's method does although eps
is small. Values are float64, the linear systems float32.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from yesnt.temporal import kernels
from yesnt.temporal.certificate import dual_value
from yesnt.temporal.geometry import FIXED, Geometry
from yesnt.temporal.params import EnergyParams

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True)
class Problem:
    """One channel to be solved on a geometry.

    Attributes:
        geometry: shared by the channels.
        observed: [N] float32.
        confidence: [N] float32.
        params: of the energy.
    """

    geometry: Geometry
    observed: Single
    confidence: Single
    params: EnergyParams

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """(delta, lambda1, lambda2, eps) as the kernels take them."""
        p = self.params
        return p.delta, p.lambda1, p.lambda2, p.eps

    @property
    def box(self) -> tuple[float, float]:
        """Range of what was observed, widened by its width on both sides; see certificate.py."""
        trusted = self.observed[(self.confidence > 0) | (self.geometry.flags & FIXED > 0)]
        if len(trusted) == 0:
            return 0.0, 1.0
        low, high = float(trusted.min()), float(trusted.max())
        width = max(high - low, 1e-3)
        return low - width, high + width


@dataclass(frozen=True)
class Limits:
    """When to stop: relative gap, largest change of a pixel, outer iterations, products per outer iteration."""

    tolerance: float = 1e-4
    step: float = np.inf
    outer: int = 100
    inner: int = 200


@dataclass
class State:
    """Where a solve stands."""

    x: Array
    energy: float
    bound: float
    outer: int = 0
    inner: int = 0
    step: float = np.inf

    @property
    def gap(self) -> float:
        """Upper bound on (F - F*) / F*; 0 where F is 0 to rounding."""
        difference = max(0.0, self.energy - self.bound)
        if difference <= 1e-15 * max(1.0, len(self.x)):
            return 0.0
        return difference / self.bound if self.bound > 0 else float("inf")


def frame_groups(geometry: Geometry, threads: int) -> NDArray[np.int64]:
    """Splits the frames into at most `threads` runs of about equal pixel counts.

    One run if a frame has a single pixel, because its stencils then touch the frame before (geometry.py).
    """
    frames = geometry.frames
    if np.any(np.diff(frames) == 1):
        threads = 1
    targets = frames[-1] * np.arange(1, threads) / threads
    edges = np.searchsorted(frames, targets)
    return np.unique(np.concatenate([[0], edges, [len(frames) - 1]])).astype(np.int64)


class NewtonSolver:
    """Holds the work arrays of one channel."""

    def __init__(self, problem: Problem) -> None:
        geometry = problem.geometry
        count, frames = geometry.pixels, len(geometry.frames) - 1
        self.problem = problem
        self.groups = frame_groups(geometry, get_num_threads())
        self.box = problem.box
        self.gradient, self.scratch = np.zeros(count), np.zeros(count)
        self.per_frame = np.zeros(frames)
        self.qx, self.qy, self.u = (np.zeros(count, np.float32) for _ in range(3))
        self.operator = tuple(np.zeros(count, np.float32) for _ in range(4))
        self.inverse = np.zeros(count, np.float32)
        self.z, self.r, self.p, self.ap = (np.zeros(count, np.float32) for _ in range(4))

    def evaluate(self, x: Array) -> float:
        """F(x); leaves the gradient in `self.gradient`."""
        problem = self.problem
        data = (problem.geometry, problem.observed, problem.confidence, problem.numbers, self.groups)
        kernels.gradient(x, self.gradient, self.per_frame, *data)
        return float(np.sum(self.per_frame))

    def bound(self, x: Array) -> float:
        """A lower bound on the minimum from the current duals and x."""
        problem = self.problem
        data = (problem.geometry, problem.observed, problem.confidence, problem.numbers, self.box, self.groups)
        dual_value(x, self.qx, self.qy, self.scratch, self.per_frame, *data)
        return float(np.sum(self.per_frame))

    def set_exact_duals(self, x: Array) -> None:
        """Sets q and u to the derivative's own at x, for solvers that carry no duals."""
        self.z[:] = 0
        problem = self.problem
        kernels.update_duals(x, self.z, self.qx, self.qy, self.u, problem.geometry, problem.observed, problem.numbers)

    def newton_direction(self, x: Array, reduction: float, limit: int) -> int:
        """Solves A z = - gradient to a relative residual of `reduction`; returns the number of products."""
        problem = self.problem
        geometry, coupling = problem.geometry, np.float32(2 * problem.params.lambda2)
        kernels.linearise(
            x, self.qx, self.qy, self.u, geometry, problem.observed, problem.confidence, problem.numbers, *self.operator
        )
        kernels.inverse_diagonal(self.inverse, geometry, self.operator, coupling, self.groups)
        frames = geometry.frames
        kernels.start_cg(self.gradient, self.inverse, self.z, self.r, self.p, frames, self.per_frame)
        rho = float(np.sum(self.per_frame))
        goal = rho * reduction**2
        for count in range(limit):
            if rho <= goal or rho == 0:
                return count
            kernels.apply(self.p, self.ap, self.per_frame, geometry, self.operator, coupling, self.groups)
            curvature = float(np.sum(self.per_frame))
            if not curvature > 0:
                return count
            alpha = np.float32(rho / curvature)
            kernels.advance(alpha, self.z, self.r, self.p, self.ap, self.inverse, frames, self.per_frame)
            previous, rho = rho, float(np.sum(self.per_frame))
            kernels.turn(np.float32(rho / previous), self.p, self.r, self.inverse)
        return limit

    def step(self, state: State, limits: Limits) -> None:
        """One outer iteration: direction, step length that lowers F, duals, bound."""
        state.inner += self.newton_direction(state.x, 0.1, limits.inner)
        state.outer += 1
        length = 1.0
        for _ in range(30):
            trial = state.x + length * self.z
            energy = self.evaluate(trial)
            if energy <= state.energy:
                break
            length *= 0.5
        else:
            trial, energy, length = state.x, self.evaluate(state.x), 0.0
        self.z *= np.float32(length)
        problem = self.problem
        kernels.update_duals(
            state.x, self.z, self.qx, self.qy, self.u, problem.geometry, problem.observed, problem.numbers
        )
        state.step = float(np.max(np.abs(self.z), initial=0.0))
        state.x, state.energy = trial, energy
        state.bound = max(state.bound, self.bound(trial))


def solve_newton(problem: Problem, start: Array, limits: Limits) -> State:
    """Minimises F from `start` [N] until the certified gap is below the tolerance."""
    solver = NewtonSolver(problem)
    state = State(x=start, energy=solver.evaluate(start), bound=-np.inf)
    while state.outer < limits.outer and (state.gap > limits.tolerance or state.step > limits.step):
        solver.step(state, limits)
    return state
