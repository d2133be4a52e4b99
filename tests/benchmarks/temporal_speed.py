"""Processor seconds to a relative gap: the default solver against Adam (PyTorch, the paper's way) and others, one run.

    python tests/benchmarks/temporal_speed.py [--size 16x270x480] [--long]

The default solver's time ends when the gap is *certified*; the rivals' when their energy truly is that close to the
minimum, which they cannot know. One thread and processor time, which hardly feel other work on the machine. `--long`
prints the time per matte pixel and frame from 16 to 256 frames.
"""

import argparse
import importlib.util
import sys
import time
from pathlib import Path

import numba
import numpy as np
import torch
from scipy.optimize import minimize

from yesnt.temporal import solve
from yesnt.temporal.newton import Limits, NewtonSolver, State
from yesnt.temporal.solver import channel_problem, check_inputs

LEVELS = (1e-2, 1e-3, 1e-4)


def moving_pattern(*size, **options):
    spec = importlib.util.spec_from_file_location(
        "temporal_conftest", Path(__file__).parents[1] / "temporal/conftest.py"
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module.moving_pattern(*size, **options)


class TorchEnergy:
    """F on dense frames with autograd, as a PyTorch implementation of the paper has it; validity precomputed."""

    def __init__(self, problem):
        self.params = problem.params
        matte = torch.from_numpy(problem.matte.astype(np.float32))
        self.matte, self.observed = matte, torch.from_numpy(problem.observed)
        self.confidence = torch.from_numpy(problem.confidence) * matte
        height, width = matte.shape[1:]
        rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        x, y = columns + torch.from_numpy(problem.flow[..., 0]), rows + torch.from_numpy(problem.flow[..., 1])
        self.grid = torch.stack([2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1], -1)
        weight = self.sample(matte[1:])
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        self.valid = torch.from_numpy(problem.validity) * matte[:-1] * inside * (weight >= 0.5)
        self.normal = 1 / weight.clamp(min=0.5)
        self.right, self.down = matte[:, :, 1:] * matte[:, :, :-1], matte[:, 1:] * matte[:, :-1]

    def sample(self, image):
        return torch.nn.functional.grid_sample(image[:, None], self.grid, align_corners=True)[:, 0]

    def __call__(self, x):
        p, pad = self.params, torch.nn.functional.pad
        r = (x - self.observed).abs()
        data = self.confidence * torch.where(r <= p.delta, 0.5 * r * r, p.delta * (r - 0.5 * p.delta))
        dx = pad((x[:, :, 1:] - x[:, :, :-1]) * self.right, (0, 1))
        dy = pad((x[:, 1:] - x[:, :-1]) * self.down, (0, 0, 0, 1))
        space = self.matte * torch.sqrt(dx * dx + dy * dy + p.eps**2)
        warped = self.sample(x[1:] * self.matte[1:]) * self.normal
        return data.sum() + p.lambda1 * space.sum() + p.lambda2 * (self.valid * (warped - x[:-1]) ** 2).sum()


def torch_adam(problem, minimum, rate, steps):
    """{level: (steps, seconds)} of Adam at a constant rate."""
    energy = TorchEnergy(problem)
    x = energy.observed.clone().requires_grad_(True)
    optimiser = torch.optim.Adam([x], lr=rate)
    reached, seconds = {}, 0.0
    for step in range(1, steps + 1):
        started = time.process_time()
        optimiser.zero_grad(set_to_none=True)
        loss = energy(x)
        loss.backward()
        optimiser.step()
        seconds += time.process_time() - started
        note(reached, loss.item() / minimum - 1, (step, seconds))
        if min(LEVELS[:2]) in reached:
            break
    return reached, seconds / step


def note(reached, gap, value):
    for level in LEVELS:
        if gap <= level:
            reached.setdefault(level, value)


def newton_trace(problem, minimum, damping=None):
    """Seconds and products to the true gap; `damping=0` is reweighted least squares."""
    started = time.process_time()
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    solver = NewtonSolver(channel_problem(inputs, 0, problem.params))
    x = solver.problem.observed.astype(np.float64)
    state, true = State(x=x, energy=solver.evaluate(x), bound=-np.inf), {}
    while min(LEVELS) not in true and state.outer < 60:
        if damping is not None:
            solver.damping = damping
        solver.step(state, Limits())
        note(true, state.energy / minimum - 1, (state.inner, time.process_time() - started))
    return true


def certified_solves(problem):
    """{level: (products, seconds)} of a whole solve to each certified gap."""
    reached = {}
    for level in LEVELS:
        started = time.process_time()
        stats = solve(*problem.arguments, tolerance=level).stats
        reached[level] = (stats.inner_iterations, time.process_time() - started)
    return reached


def lbfgs(problem, minimum):
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    solver, reached = NewtonSolver(channel_problem(inputs, 0, problem.params)), {}
    started, calls = time.process_time(), [0]

    def function(x):
        calls[0] += 1
        energy = solver.evaluate(x)
        note(reached, energy / minimum - 1, (calls[0], time.process_time() - started))
        if LEVELS[-1] in reached:
            raise StopIteration
        return energy, solver.gradient.copy()

    try:
        minimize(function, solver.problem.observed.astype(float), jac=True, method="L-BFGS-B", options={"maxiter": 200})
    except StopIteration:
        pass
    return reached


def show(name, reached):
    cells = [
        f"{reached[level][1]:8.2f} s ({reached[level][0]:4d})" if level in reached else "       -        "
        for level in LEVELS
    ]
    print(f"{name:34s}" + "  ".join(cells), flush=True)


def compare(size):
    problem = moving_pattern(*size)
    solve(*moving_pattern(3, 20, 20).arguments)  # compiles
    minimum = solve(*problem.arguments, tolerance=1e-6).stats.energy
    print(f"{size} frames x rows x columns, {int(problem.matte.sum())} matte pixels; seconds (products or steps) to")
    print(f"{'':34s}" + "  ".join(f"{level:16.0e}" for level in LEVELS))
    certified = certified_solves(problem)
    show("default, certified", certified)
    show("default, true gap", newton_trace(problem, minimum))
    show("reweighted least squares, true", newton_trace(problem, minimum, damping=0.0))
    show("L-BFGS, same kernels, true", lbfgs(problem, minimum))
    small = moving_pattern(4, size[1] // 2, size[2] // 2)
    small_minimum = solve(*small.arguments, tolerance=1e-6).stats.energy
    rates = (0.005, 0.007, 0.01, 0.014, 0.02, 0.028)
    steps = {rate: torch_adam(small, small_minimum, rate, 300)[0].get(1e-3, (999,))[0] for rate in rates}
    best = min(steps, key=steps.get)
    print(f"Adam's steps to 1e-3 on a smaller problem by rate: {steps}")
    adam, each = torch_adam(problem, minimum, best, 300)
    show(f"Adam, PyTorch, rate {best}, true", adam)
    print(
        f"  {each:.3f} s a step; to 1e-3 the default, certified, is {adam[1e-3][1] / certified[1e-3][1]:.1f} x faster"
    )
    fused(problem, minimum, best)


def fused(problem, minimum, rate):
    """Adam on this package's own kernels: what the kernels alone are worth."""
    inputs = check_inputs(*problem.arguments[:4], problem.matte)
    solver, reached = NewtonSolver(channel_problem(inputs, 0, problem.params)), {}
    x = solver.problem.observed.astype(np.float64)
    mean, square, started = np.zeros_like(x), np.zeros_like(x), time.process_time()
    for step in range(1, 300):
        energy = solver.evaluate(x)
        note(reached, energy / minimum - 1, (step, time.process_time() - started))
        if 1e-3 in reached:
            break
        mean += 0.1 * (solver.gradient - mean)
        square += 0.001 * (solver.gradient**2 - square)
        x -= rate * (mean / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
    show(f"Adam, our kernels, rate {rate}, true", reached)


def length_scaling(height=96, width=128, longest=256):
    """Cost of a matte pixel of a frame by length: windows of one long sequence, so that only the length differs."""
    problem, costs = moving_pattern(longest, height, width, speed=0.2), []
    for frames in (16, 32, 64, 128, 256):
        count = min(4, longest // frames)
        starts = [(longest - frames) * k // max(1, count - 1) for k in range(count)]
        seconds, pixels, products = 0.0, 0, []
        for start in starts:
            part = problem.cut(slice(start, start + frames))
            runs = []
            for _ in range(2):
                started = time.process_time()
                found = solve(*part).stats
                runs.append(time.process_time() - started)
            seconds, pixels = seconds + min(runs), pixels + found.pixels
            products.append(found.inner_iterations)
        costs.append(seconds / pixels)
        print(
            f"{frames:4d} frames, products {products}, {1e9 * costs[-1]:6.0f} ns a matte pixel of a frame", flush=True
        )
    print(f"largest over smallest {max(costs) / min(costs):.3f}; over 16 frames', ", end="")
    print(f"{min(costs) / costs[0]:.2f} .. {max(costs) / costs[0]:.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="16x270x480")
    parser.add_argument("--long", action="store_true")
    options = parser.parse_args()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    if options.long:
        length_scaling()
    else:
        compare(tuple(int(v) for v in options.size.split("x")))


if __name__ == "__main__":
    main()
