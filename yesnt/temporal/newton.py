"""The default solver: primal-dual Newton steps, each solved by preconditioned conjugate gradients on matte pixels.

A step from q = 0, u = 0 is iteratively reweighted least squares (lagged diffusivity), which never raises F; once the
duals are warm the steps are those of Chan, Golub and Mulet (1999), which converge as Newton's method does although eps
is small. Values are float64, the linear systems float32.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.temporal import kernels
from yesnt.temporal.certificate import dual_value
from yesnt.temporal.geometry import FIXED, Geometry
from yesnt.temporal.params import EnergyParams
from yesnt.temporal.threads import FrameThreads

Array = NDArray[np.float64]
Single = NDArray[np.float32]


MINIMAL_LENGTH = 1e-9
"""Shortest step that the line search tries."""

SINGLE_STIFFNESS = 2e4
"""Stiffness from which the linear systems are solved in float64: conjugate gradients stall at stiffness x rounding."""

EASY_STEPS, EASY_DAMPING, EASY_REDUCTION = 8, 0.95, 0.2
"""The first steps trust the duals a little less and solve their systems roughly: most problems end there, in half the
products. At full trust saturated pixels weigh nothing, which makes systems close to singular."""

HARD_REDUCTION = 0.1
"""Relative residual of the systems of all later steps, at full trust: stiff problems need it."""

POLISH = 0.5
"""Damping of the Jacobi step that ends each linear solve. It costs no product, and what it removes, the residual from
pixel to pixel, is what the certificate charges for: the gap falls by a third to a half."""

AIM = 0.6
"""Share of the tolerance that a last step aims at: its system is solved only as well as the gap still needs. Without it
the number of products jumps by a whole step's when the gap misses the tolerance by little."""

HOPELESS = 30.0
"""A step that lowered F by more than this many tolerances is not certified: the next one lowers F again for sure, and a
certificate costs as much as four products."""

IDLE_LIMIT = 4
"""Outer iterations without progress of F or of the bound after which a solve stops: rounding allows no more."""


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
    def stiffness(self) -> float:
        """Largest eigenvalue that the linear systems can have, roughly."""
        return 8 * (self.params.lambda1 / self.params.eps + self.params.lambda2)

    @property
    def stiff(self) -> bool:
        """Whether systems need float64 and care."""
        return self.stiffness >= SINGLE_STIFFNESS

    @property
    def box(self) -> tuple[float, float]:
        """Range of what was observed, widened by its width on both sides; see certificate.py."""
        weighted = self.observed[(self.confidence > 0) | (self.geometry.flags & FIXED > 0)]
        if len(weighted) == 0:
            return 0.0, 1.0
        low, high = float(weighted.min()), float(weighted.max())
        width = max(high - low, 1e-3)
        return low - width, high + width


@dataclass(frozen=True)
class Limits:
    """When to stop: relative gap, largest change of a pixel, outer iterations, products per outer iteration."""

    tolerance: float = 1e-4
    step: float = np.inf
    outer: int = 300
    inner: int = 400


class Outcome(NamedTuple):
    """What a solve leaves beside its value: energy, gap, outer iterations, products, last step."""

    energy: float
    gap: float
    outer: int
    inner: int
    step: float


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

    @property
    def outcome(self) -> Outcome:
        """The state without its value, which a caller need not keep."""
        return Outcome(self.energy, self.gap, self.outer, self.inner, self.step)


class NewtonSolver:
    """Holds the work arrays of one channel.

    A pixel costs 48 bytes beside its value: rows of one array, of which some serve twice. `trial` and `scratch`
    (float64) lie on the operator, which is made anew from what they are used for; the gradient lies on the search
    direction and its product, which begin when the gradient has been taken over as the residual.
    """

    def __init__(self, problem: Problem) -> None:
        geometry = problem.geometry
        count, frames = geometry.pixels, len(geometry.frames) - 1
        self.problem = problem
        self.run = FrameThreads(geometry).run
        self.box = problem.box
        self.per_frame = np.zeros(frames)
        self.qx, self.qy, self.u = (np.zeros(count, np.float32) for _ in range(3))
        self.damping = EASY_DAMPING
        kind: type[Any] = np.float64 if problem.stiff else np.float32
        self.coupling = kind(2 * problem.params.lambda2)
        work = np.zeros((9, count), kind)
        self.operator: tuple[NDArray[Any], ...] = tuple(work[:4])
        self.p, self.ap, self.z, self.r, self.inverse = work[4:]
        self.trial, self.scratch, self.gradient = (_as_doubles(work[i : i + 2]) for i in (0, 2, 4))

    def evaluate(self, x: Array) -> float:
        """F(x); leaves the gradient in `self.gradient`."""
        problem = self.problem
        data = (problem.geometry, problem.observed, problem.confidence, problem.numbers)
        self.run(kernels.gradient, x, self.gradient, self.per_frame, *data)
        return float(np.sum(self.per_frame))

    def bound(self, x: Array) -> float:
        """A lower bound on the minimum from the current duals and x."""
        problem = self.problem
        data = (problem.geometry, problem.observed, problem.confidence, problem.numbers, self.box)
        return float(dual_value(x, self.qx, self.qy, self.scratch, *data))

    def set_exact_duals(self, x: Array) -> None:
        """Sets q and u to the derivative's own at x, for solvers that carry no duals."""
        self.z[:] = 0
        problem = self.problem
        duals = (self.qx, self.qy, self.u)
        self.run(kernels.update_duals, x, self.z, *duals, problem.geometry, problem.observed, problem.numbers)

    def newton_direction(self, x: Array, reduction: float, limit: int) -> int:
        """Solves A z = - gradient to a relative residual of `reduction`; returns the number of products."""
        problem = self.problem
        geometry, coupling, kind = problem.geometry, self.coupling, type(self.coupling)
        data = (geometry, problem.observed, problem.confidence, problem.numbers)
        self.run(kernels.linearise, x, (self.qx, self.qy, self.u), self.damping, *data, self.operator)
        self.run(kernels.inverse_diagonal, self.inverse, geometry, self.operator, coupling)
        frames = geometry.frames
        self.run(kernels.start_cg, self.gradient, self.inverse, self.z, self.r, frames, self.per_frame)
        np.multiply(self.r, self.inverse, out=self.p)  # only now: the gradient lay here
        rho = float(np.sum(self.per_frame))
        goal = rho * reduction**2
        for count in range(limit):
            if rho <= goal or rho == 0:
                return count
            self.run(kernels.apply, self.p, self.ap, self.per_frame, geometry, self.operator, coupling)
            curvature = float(np.sum(self.per_frame))
            if not curvature > 0:
                return count
            alpha = kind(rho / curvature)
            self.run(kernels.advance, alpha, self.z, self.r, self.p, self.ap, self.inverse, frames, self.per_frame)
            previous, rho = rho, float(np.sum(self.per_frame))
            self.run(kernels.turn, kind(rho / previous), self.p, self.r, self.inverse, frames)
        return limit

    def polish(self) -> None:
        """One damped Jacobi step on what the conjugate gradients left of the residual; stiff systems gain nothing."""
        if self.problem.stiff:
            return
        np.multiply(self.inverse, self.r, out=self.p)
        self.p *= type(self.coupling)(POLISH)
        self.z += self.p

    def reduction(self, state: State, limits: Limits) -> float:
        """How far the next linear system's residual is brought down; the gap falls by about as much."""
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
        problem = self.problem
        duals = (self.qx, self.qy, self.u)
        self.run(kernels.update_duals, state.x, self.z, *duals, problem.geometry, problem.observed, problem.numbers)
        state.step = float(np.max(np.abs(self.z), initial=0.0))
        state.x += self.z
        if self.widen_box(state.x):
            state.bound = -np.inf  # bounds over a smaller box say nothing about the new one
        if before - state.energy <= HOPELESS * limits.tolerance * state.energy:
            state.bound = max(state.bound, self.bound(state.x))

    def widen_box(self, x: Array) -> bool:
        """Keeps a sixth of the box's width free on both sides of x; returns whether it had to grow.

        Unreliable flow and no confidence can put the minimum far outside what was observed.
        """
        low, high = float(np.min(x, initial=np.inf)), float(np.max(x, initial=-np.inf))
        margin = (self.box[1] - self.box[0]) / 6
        if low > self.box[0] + margin and high < self.box[1] - margin:
            return False
        width = high - low
        self.box = min(self.box[0], low - width), max(self.box[1], high + width)
        return len(x) > 0

    def line_search(self, state: State) -> float:
        """Halves the direction until F does not rise; scales `self.z` by the length found and sets the energy."""
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
    """The memory of two neighbouring rows [2, N], or of the first if they are float64, as [N] float64."""
    return rows[0] if rows.dtype == np.float64 else rows.reshape(-1).view(np.float64)


def solve_newton(problem: Problem, start: Array, limits: Limits) -> State:
    """Minimises F from `start` [N], in its memory, until the gap is below the tolerance or rounding allows no more."""
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
