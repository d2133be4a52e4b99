"""Random temporal problems and an independent float64 minimiser."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from yesnt.temporal import EnergyParams, reference


@dataclass(frozen=True)
class TemporalProblem:
    observed: np.ndarray
    confidence: np.ndarray
    flow: np.ndarray
    validity: np.ndarray
    params: EnergyParams
    matte: np.ndarray
    truth: np.ndarray | None = None

    @property
    def arguments(self):
        return self.observed, self.confidence, self.flow, self.validity, self.params, self.matte

    def cut(self, span):
        links = slice(span.start, span.stop - 1)
        return (
            self.observed[span],
            self.confidence[span],
            self.flow[links],
            self.validity[links],
            self.params,
            self.matte[span],
        )

    def reference_energy(self, x):
        wide = (np.asarray(a, np.float64) for a in (x, self.observed, self.confidence, self.flow, self.validity))
        return sum(reference.energy_terms(*wide, self.params, self.matte))

    def changed(self, **fields):
        return replace(self, **fields)


def draw_problem(seed):
    """Sizes, masks, weights, flows that leave the frame: everything random, confidence down to 0."""
    rng = np.random.default_rng(seed)
    frames, height, width = rng.integers(1, 7), rng.integers(3, 20), rng.integers(3, 20)
    shape = (frames, height, width)
    params = EnergyParams(
        delta=10 ** rng.uniform(-2, 0),
        lambda1=0.0 if seed % 7 == 1 else 10 ** rng.uniform(-3, 3),
        lambda2=0.0 if seed % 7 == 2 else 10 ** rng.uniform(-3, 3),
        eps=10 ** rng.uniform(-6, -1),
    )
    confidence = 1 - np.clip(rng.normal(0.3, 0.4, shape), 0, 1)
    return TemporalProblem(
        observed=rng.random(shape).astype(np.float32),
        confidence=confidence.astype(np.float32),
        flow=rng.normal(0, rng.uniform(0, 4), (frames - 1, height, width, 2)).astype(np.float32),
        validity=(rng.random((frames - 1, height, width)) > 0.2).astype(np.float32),
        params=params,
        matte=rng.random(shape) < rng.uniform(0.3, 1.1),
    )


def moving_pattern(frames, height, width, noise=0.08, seed=0, speed=1.3):
    """A textured ellipse that moves by a known flow, seen through noise and 3 % outliers."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    shape = (frames, height, width)
    truth, matte = np.zeros(shape), np.zeros(shape, bool)
    flow = np.zeros((frames - 1, height, width, 2), np.float32)
    for t in range(frames):
        right, down = speed * t, 0.7 * np.sin(t / 5)
        column, row = x - right, y - down
        body = (column - width * 0.5 + 0.5 * speed * frames) / (0.3 * width), (row - height * 0.5) / (0.45 * height)
        matte[t] = body[0] ** 2 + body[1] ** 2 < 1
        steps = np.sign(np.sin(column / 7) + np.sin(row / 9))
        truth[t] = 0.5 + 0.2 * steps + 0.1 * np.sin(column / 4) * np.cos(row / 5)
    flow[..., 0] = speed
    flow[..., 1] = np.diff(0.7 * np.sin(np.arange(frames) / 5))[:, None, None]
    std = rng.uniform(0, 0.6, shape)
    observed = truth + noise * (0.5 + 2 * std) * rng.standard_normal(shape)
    observed = np.where(rng.random(shape) < 0.03, rng.random(shape), observed)
    return TemporalProblem(
        observed=observed.astype(np.float32),
        confidence=(1 - std).astype(np.float32),
        flow=flow,
        validity=np.ones((frames - 1, height, width), np.float32),
        params=EnergyParams(),
        matte=matte,
        truth=truth,
    )


class SparseMinimiser:
    """F from sparse matrices that are probed from the plain reference; minimised by damped Newton steps, LU-solved."""

    def __init__(self, problem):
        self.params, self.problem = problem.params, problem
        matte = problem.matte
        self.index = np.cumsum(matte).reshape(matte.shape) - 1
        self.count = int(matte.sum())
        self.observed = problem.observed[matte].astype(np.float64)
        self.confidence = problem.confidence[matte].astype(np.float64)
        self.dx, self.dy = self._difference(2), self._difference(1)
        self.links, self.link_weight = self._links()

    def _matrix(self, rows, columns, values, height):
        return sp.csr_matrix((values, (rows, columns)), shape=(height, self.count))

    def _difference(self, axis):
        matte, step = self.problem.matte, [0, 0, 0]
        step[axis] = 1
        rows, columns, values = [], [], []
        for t, i, j in np.argwhere(matte):
            other = (t + step[0], i + step[1], j + step[2])
            if other[axis] < matte.shape[axis] and matte[other]:
                here = self.index[t, i, j]
                rows += [here, here]
                columns += [here, self.index[other]]
                values += [-1.0, 1.0]
        return self._matrix(rows, columns, values, self.count)

    def _links(self):
        """One row W x_{t+1} - x_t for each link, by probing the reference warp with one pixel at a time."""
        problem, rows, columns, values = self.problem, [], [], []
        weight = np.zeros(self.count)
        for t in range(len(problem.matte) - 1):
            flow, target = problem.flow[t].astype(np.float64), problem.matte[t + 1]
            _, valid = reference.warp(np.zeros(target.shape), flow, target)
            here = problem.matte[t] & valid & (problem.validity[t] > 0)
            weight[self.index[t][here]] = problem.validity[t][here]
            rows += list(self.index[t][here])
            columns += list(self.index[t][here])
            values += [-1.0] * int(here.sum())
            for i, j in np.argwhere(target):
                probe = np.zeros(target.shape)
                probe[i, j] = 1
                seen = reference.warp(probe, flow, target)[0]
                hit = here & (seen != 0)
                rows += list(self.index[t][hit])
                columns += [self.index[t + 1, i, j]] * int(hit.sum())
                values += list(seen[hit])
        return self._matrix(rows, columns, values, self.count), weight

    def energy(self, x):
        p = self.params
        dx, dy, e = self.dx @ x, self.dy @ x, self.links @ x
        data = np.sum(self.confidence * reference.huber(self.observed - x, p.delta))
        return (
            data + p.lambda1 * np.sum(np.sqrt(dx**2 + dy**2 + p.eps**2)) + p.lambda2 * np.sum(self.link_weight * e**2)
        )

    def _step(self, x, newton):
        p, r = self.params, x - self.observed
        dx, dy, e = self.dx @ x, self.dy @ x, self.links @ x
        tau = np.sqrt(dx**2 + dy**2 + p.eps**2)
        inside = np.abs(r) <= p.delta
        data = self.confidence * np.where(inside, 1.0, 0.0 if newton else p.delta / np.maximum(np.abs(r), p.delta))
        slope = self.confidence * np.clip(r, -p.delta, p.delta)
        a, b, d = (np.ones_like(tau), np.zeros_like(tau), np.ones_like(tau))
        if newton:
            a, b, d = 1 - (dx / tau) ** 2, -dx * dy / tau**2, 1 - (dy / tau) ** 2
        space = p.lambda1 / tau
        gradient = slope + self.dx.T @ (space * dx) + self.dy.T @ (space * dy)
        gradient += 2 * p.lambda2 * (self.links.T @ (self.link_weight * e))
        hessian = sp.diags(data) + 2 * p.lambda2 * self.links.T @ sp.diags(self.link_weight) @ self.links
        hessian += self.dx.T @ sp.diags(space * a) @ self.dx + self.dy.T @ sp.diags(space * d) @ self.dy
        cross = self.dx.T @ sp.diags(space * b) @ self.dy
        hessian = hessian + cross + cross.T
        tiny = 1e-10 * max(float(hessian.diagonal().max()), 1.0) * sp.identity(self.count)
        return -splu((hessian + tiny).tocsc()).solve(gradient)

    def minimum(self, start, steps=200):
        """The smallest energy of a long run: reweighted least squares, then Newton steps that must lower F."""
        x, energy = start.astype(np.float64), self.energy(start.astype(np.float64))
        for k in range(steps):
            z, length = self._step(x, newton=k % 3 == 2), 1.0
            while length > 1e-6 and self.energy(x + length * z) >= energy:
                length *= 0.5
            lower = self.energy(x + length * z)
            if lower >= energy:
                if k % 3 == 2:
                    break
                continue
            x, energy = x + length * z, lower
        return energy


@pytest.fixture(scope="session")
def problem_drawn():
    return draw_problem


@pytest.fixture(scope="session")
def pattern():
    return moving_pattern


@pytest.fixture(scope="session")
def minimiser():
    return SparseMinimiser
