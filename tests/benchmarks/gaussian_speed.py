"""Times the rasteriser of Gaussian fields and its gradients, against torch's autograd and on a large field.

python -m tests.benchmarks.gaussian_speed [--count 1000] [--size 96] [--steps 40] [--large 1000000]

A field of discs on a ball. Prints Gaussians x pixels a processor second of the forward and of the backward pass, steps
of a fit a processor second, the ratio to torch_render.py (the same lists of tiles) in the same run, and seconds and
peak memory of a picture of 1920 x 1080 with --large Gaussians (0 leaves it out). Seconds are of the processor, with
one thread for both, since waiting threads count too.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import replace

import numba
import numpy as np
import torch

from tests.gaussians.scenes import camera_at, shell
from yesnt.gaussians.fit import Pictures, take_step
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.rasterise import arrays_of, backpropagate, pinhole_of, rasterise
from yesnt.gaussians.records import View
from yesnt.gaussians.render import render
from yesnt.gaussians.settings import FitSettings
from yesnt.gaussians.targets import Target
from yesnt.gaussians.torch_render import TorchField, render_tiles

NAMES = ("positions", "log_scales", "rotations", "opacity_logits", "harmonics")


def seconds(work, times=3):
    """Least processor seconds of several calls after a first one that compiles."""
    work()
    taken = []
    for _ in range(times):
        started = time.process_time()
        work()
        taken.append(time.process_time() - started)
    return min(taken)


def view_of(size, eye=(1.4, 0.0, 0.3)):
    return View.of(camera_at(eye, size, 1.6 * size[1]))


def compare(count, size):
    """Forward and backward of the kernels and of torch."""
    field, view = shell(count), view_of((size, size))
    arrays, pinhole = arrays_of(field), pinhole_of(view, np.zeros(3), 0.05)
    raster = rasterise(arrays, pinhole)
    weights = np.random.default_rng(0).normal(size=(10, size, size)).astype(np.float32)
    forward = seconds(lambda: rasterise(arrays, pinhole))
    backward = seconds(lambda: backpropagate(arrays, raster, weights))

    def torch_both():
        torch_field = TorchField.of(arrays)
        images = render_tiles(torch_field, pinhole, raster.lists)[:, :size, :size]
        (images * images.new_tensor(weights)).sum().backward()
        return torch_field

    by_torch, found = torch_both(), backpropagate(arrays, raster, weights)
    errors = []
    for name in NAMES:
        expected = getattr(by_torch, name).grad.numpy()
        errors.append(np.abs(getattr(found, name) - expected).max() / np.abs(expected).max())
    slow = seconds(torch_both, 1)
    work = count * size * size
    print(
        f"{count} Gaussians, {size} x {size}: forward {forward:.4f} s, {work / forward:.3g} Gaussians x pixels a second"
    )
    print(f"  backward {backward:.4f} s, {work / backward:.3g} Gaussians x pixels a second")
    print(f"  torch {slow:.2f} s, {slow / (forward + backward):.0f} times both; gradients differ by {max(errors):.1e}")


def fit_steps(count, size, steps):
    """Steps of a fit at whole resolution with all losses."""
    eyes = [(1.4 * np.cos(a), 1.4 * np.sin(a), 0.3) for a in np.arange(6) * np.pi / 3]
    views = [view_of((size, size), eye) for eye in eyes]
    seen = [render(shell(count), view) for view in views]
    targets = [Target.cropped(view, picture.color, picture.alpha) for view, picture in zip(views, seen, strict=True)]
    start = replace(shell(count), positions=shell(count).positions * np.float32(1.02))
    state, settings = FitState.of(start, 0.6, 1.4 / (1.6 * size)), FitSettings(half=0, geometry_from=0, every=10**9)
    pictures = Pictures.of(targets)
    take_step(state, pictures, settings, 0)
    started = time.process_time()
    for _ in range(steps):
        take_step(state, pictures, settings, 0)
    print(
        f"  fit {steps / (time.process_time() - started):.1f} steps a second, all losses, {targets[0].matte.shape} crop"
    )


def large(count):
    """One picture of a large field."""
    field, view = shell(count), view_of((1920, 1080))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    taken = []
    for _ in range(2):
        wall, processor = time.monotonic(), time.process_time()
        picture = render(field, view)
        taken = [time.process_time() - processor, time.monotonic() - wall]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(f"{count} Gaussians, 1920 x 1080: {taken[0]:.1f} processor seconds ({taken[1]:.1f} s), peak {peak:.0f} MiB")
    print(f"  {peak - before:.0f} MiB above the field itself; coverage {picture.alpha.mean():.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--large", type=int, default=1_000_000)
    options = parser.parse_args()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    compare(options.count, options.size)
    fit_steps(options.count, options.size, options.steps)
    if options.large:
        large(options.large)


if __name__ == "__main__":
    main()
