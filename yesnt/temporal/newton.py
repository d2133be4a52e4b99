"""The default solver: primal-dual Newton steps, each solved by preconditioned conjugate gradients on matte pixels.

A step from the duals q = 0, u = 0 is one of iteratively reweighted least squares (lagged diffusivity), which never
raises F. With converged duals the steps are those of Chan, Golub and Mulet (1999), which keep the convergence of
Newton's method for small eps. Values are float64, linear systems float32 unless they are stiff.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal import kernels, linear_system
from yesnt.temporal.certificate import dual_value
from yesnt.temporal.geometry import FIXED, Geometry
from yesnt.temporal.params import EnergyParams
from yesnt.temporal.records import Box, ConjugateGradients, Duals, Energy, NewtonMatrix
from yesnt.temporal.threads import FrameThreads

Array = NDArray[np.float64]
Single = NDArray[np.float32]


MINIMAL_LENGTH = 1e-9
"""Smallest step length of the line search."""

SINGLE_STIFFNESS = 2e4
"""Stiffness from which linear systems are float64: conjugate gradients stall at stiffness times rounding error."""

EASY_STEPS, EASY_DAMPING, EASY_REDUCTION = 8, 0.95, 0.2
"""Number of first steps, their damping factor and the relative residual of their systems. Most problems converge
within these steps, with half the products. With damping factor 1, pixels in the linear part of the Huber function have
weight 0, which makes the systems nearly singular."""

HARD_REDUCTION = 0.1
"""Relative residual of the systems of all later steps; stiff problems need it."""

POLISH = 0.5
"""Relaxation factor of the Jacobi step after each linear solve. It costs no product with A and removes the residual of
highest frequency, to which the certificate is most sensitive: the gap falls by a third to a half."""

AIM = 0.6
"""Share of the tolerance at which a last step aims: its system is solved only as far as the gap requires. Otherwise the
number of products jumps by those of a whole step when the gap misses the tolerance by little."""

UNCERTIFIED = 30.0
"""A step that lowered F by more than this many tolerances is not certified: the next step lowers F again, and a
certificate costs as much as four products with A."""

IDLE_LIMIT = 4
"""Outer iterations without progress of F or of the bound after which a solve stops: rounding allows no more."""


@dataclass(frozen=True)
class Problem:
    """The minimisation of one channel's energy.

    Attributes:
        geometry: pixel lists, shared by the channels.
        observed: [N] float32, contiguous.
        confidence: [N] float32, contiguous.
        params: weights of the terms.
    """

    geometry: Geometry
    observed: Single
    confidence: Single
    params: EnergyParams

    @property
    def energy(self) -> Energy:
        """F as the kernels take it."""
        p = self.params
        weights = float(p.delta), float(p.lambda1), float(p.lambda2), float(p.eps)
        return Energy(self.geometry, self.observed, self.confidence, *weights)

    @property
    def stiffness(self) -> float:
        """Estimate of the largest eigenvalue of the linear systems."""
        return 8 * (self.params.lambda1 / self.params.eps + self.params.lambda2)

    @property
    def stiff(self) -> bool:
        """Whether linear systems need float64."""
        return self.stiffness >= SINGLE_STIFFNESS

    @property
    def box(self) -> Box:
        """Range of the observed values, widened by its width on both sides; see certificate.py."""
        weighted = self.observed[(self.confidence > 0) | (self.geometry.flags & FIXED > 0)]
        if len(weighted) == 0:
            return Box(0.0, 1.0)
        low, high = float(weighted.min()), float(weighted.max())
        width = max(high - low, 1e-3)
        return Box(low - width, high + width)


@dataclass(frozen=True)
class Limits:
    """Stopping criteria: relative gap, largest change of a pixel, outer iterations, products per outer iteration."""

    tolerance: float = 1e-4
    step: float = np.inf
    outer: int = 300
    inner: int = 400


class Outcome(NamedTuple):
    """Statistics of a solve: energy, relative gap, outer iterations, products with A, size of the last step."""

    energy: float
    gap: float
    outer: int
    inner: int
    step: float


@dataclass
class State:
    """State of a solve: value [N], energy, lower bound of the minimum, and counters as in `Outcome`."""

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

    @property
    def outcome(self) -> Outcome:
        """The statistics, without the value."""
        return Outcome(self.energy, self.gap, self.outer, self.inner, self.step)


class NewtonSolver:
    """Newton's method on one channel, with its work arrays.

    A pixel takes 48 bytes beside its value. Rows of one array serve two purposes at different times: `trial` and
    `scratch` (float64) lie on the matrix, which is computed anew after they were used; the gradient lies on p and A p,
    which conjugate gradients write only after the gradient has become the residual.
    """

    def __init__(self, problem: Problem) -> None:
        geometry = problem.geometry
        count, frames = geometry.pixels, len(geometry.frames) - 1
        self.problem = problem
        self.energy = problem.energy
        self.run = FrameThreads(geometry).run
        self.box = problem.box
        self.per_frame = np.zeros(frames)
        self.duals = Duals(*(np.zeros(count, np.float32) for _ in range(3)))
        self.damping = EASY_DAMPING
        self.kind: type[Any] = np.float64 if problem.stiff else np.float32
        work = np.zeros((9, count), self.kind)
        data, xx, xy, yy, p, ap, self.z, r, inverse = work
        self.matrix = NewtonMatrix(data, xx, xy, yy, self.kind(2 * problem.params.lambda2))
        self.cg = ConjugateGradients(self.z, r, p, ap, inverse, geometry.frames, self.per_frame)
        self.trial, self.scratch, self.gradient = (_as_doubles(work[i : i + 2]) for i in (0, 2, 4))

    def evaluate(self, x: Array) -> float:
        """Returns F(x) and writes the gradient to `self.gradient`."""
        self.run(kernels.gradient, x, self.gradient, self.per_frame, self.energy)
        return float(np.sum(self.per_frame))

    def bound(self, x: Array) -> float:
        """A lower bound on the minimum of F, from x and the current duals."""
        return float(dual_value(x, self.duals, self.scratch, self.energy, self.box))

    def set_exact_duals(self, x: Array) -> None:
        """Sets the duals to those of the gradient at x, for solvers that carry none."""
        self.z[:] = 0
        self.run(kernels.update_duals, x, self.z, self.duals, self.energy)

    def newton_direction(self, x: Array, reduction: float, limit: int) -> int:
        """Solves A z = -gradient to a relative residual of `reduction`; returns the number of products with A."""
        geometry, cg = self.problem.geometry, self.cg
        self.run(kernels.linearise, x, self.duals, self.damping, self.energy, self.matrix)
        self.run(linear_system.inverse_diagonal, cg.inverse, geometry, self.matrix)
        self.run(linear_system.start_cg, self.gradient, cg)
        np.multiply(cg.r, cg.inverse, out=cg.p)  # only now: the gradient lay here
        rho = float(np.sum(cg.dots))
        goal = rho * reduction**2
        for count in range(limit):
            if rho <= goal or rho == 0:
                return count
            self.run(linear_system.apply, cg.p, cg.ap, cg.dots, geometry, self.matrix)
            curvature = float(np.sum(cg.dots))
            if not curvature > 0:
                return count
            self.run(linear_system.advance, self.kind(rho / curvature), cg)
            previous, rho = rho, float(np.sum(cg.dots))
            self.run(linear_system.turn, self.kind(rho / previous), cg)
        return limit

    def polish(self) -> None:
        """One relaxed Jacobi step on the residual of the conjugate gradients; stiff systems gain nothing by it."""
        if self.problem.stiff:
            return
        step = np.multiply(self.cg.inverse, self.cg.r, out=self.cg.p)
        step *= self.kind(POLISH)
        self.z += step

    def reduction(self, state: State, limits: Limits) -> float:
        """Relative residual to which the next linear system is solved; the gap falls by about the same factor."""
        usual = EASY_REDUCTION if state.outer < EASY_STEPS else HARD_REDUCTION
        if self.problem.stiff or np.isfinite(limits.step) or not 0 < state.gap < np.inf:
            return usual
        return max(usual, min(AIM, AIM * limits.tolerance / state.gap))

    def step(self, state: State, limits: Limits) -> None:
        """One outer iteration: direction, step length that lowers F, duals, bound."""
        easy, before = state.outer < EASY_STEPS, state.energy
        state.inner += self.newton_direction(state.x, self.reduction(state, limits), limits.inner)
        self.polish()
        state.outer += 1
        length = self.line_search(state)
        raised = min(EASY_DAMPING if easy else 1.0, 1 - 0.6 * (1 - self.damping))
        self.damping = raised if length == 1.0 else max(self.damping - 0.2, 0.5 * self.damping)
        self.run(kernels.update_duals, state.x, self.z, self.duals, self.energy)
        state.step = float(np.max(np.abs(self.z), initial=0.0))
        state.x += self.z
        if self.widen_box(state.x):
            state.bound = -np.inf  # a bound over a smaller box does not hold for the new one
        if before - state.energy <= UNCERTIFIED * limits.tolerance * state.energy:
            state.bound = max(state.bound, self.bound(state.x))

    def widen_box(self, x: Array) -> bool:
        """Keeps a sixth of the box's width free on both sides of x; returns whether the box had to grow.

        Where the confidence is 0 and the flow unreliable, the minimum can lie far outside the observed values.
        """
        low, high = float(np.min(x, initial=np.inf)), float(np.max(x, initial=-np.inf))
        margin = (self.box.high - self.box.low) / 6
        if low > self.box.low + margin and high < self.box.high - margin:
            return False
        width = high - low
        self.box = Box(min(self.box.low, low - width), max(self.box.high, high + width))
        return len(x) > 0

    def line_search(self, state: State) -> float:
        """Halves the step until F does not rise; scales `self.z` by the length, sets the energy, returns the length."""
        length = 1.0
        while length > MINIMAL_LENGTH:
            energy = self.evaluate(np.add(state.x, self.z, out=self.trial))
            if energy <= state.energy:
                state.energy = energy
                return length
            length *= 0.5
            self.z *= 0.5
        self.z[:] = 0
        state.energy = self.evaluate(state.x)
        return 0.0


def _as_doubles(rows: NDArray[Any]) -> Array:
    """Memory of two consecutive float32 rows [2, N], or of the first of two float64 rows, as [N] float64."""
    return rows[0] if rows.dtype == np.float64 else rows.reshape(-1).view(np.float64)


def solve_newton(problem: Problem, start: Array, limits: Limits) -> State:
    """Minimises F from `start` [N], which it overwrites, until `limits` are met or rounding allows no progress."""
    solver = NewtonSolver(problem)
    state = State(x=start, energy=solver.evaluate(start), bound=-np.inf)
    idle = 0
    while state.outer < limits.outer and (state.gap > limits.tolerance or state.step > limits.step):
        energy, bound = state.energy, state.bound
        solver.step(state, limits)
        stuck = energy - state.energy <= 1e-14 * energy and state.bound <= bound + 1e-3 * (energy - bound)
        idle = idle + 1 if stuck else 0
        if idle == IDLE_LIMIT:
            break
    return state
