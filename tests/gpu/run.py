"""Checks and times what of the product runs on CUDA against the CPU's reference; takes under five minutes.

    python -m tests.gpu.run [--device cuda|cpu] [--small]

The exit status is 0 if all agree, 1 if one differs, 3 if there is no such device. `--device cpu` runs the same
comparisons without a card.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np
import torch

from tests.gpu.paths import Arrays, Path, paths

AGREE, DIFFER, NO_DEVICE = 0, 1, 3
"""Exit statuses; 2 is that of wrong arguments."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a table and returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.gpu.run")
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda")
    parser.add_argument("--small", action="store_true", help="tiny inputs, for a test of this script")
    given = parser.parse_args(arguments)
    if given.device == "cuda" and not torch.cuda.is_available():
        print("Nothing was checked: torch finds no CUDA device here; `--device cpu` runs the comparisons on the CPU.")
        return NO_DEVICE
    print(torch.cuda.get_device_name() if given.device == "cuda" else "the CPU in place of a card")
    print("path | difference / tolerance | same bytes again | reference s | device s")
    agree = [check(path, given.device) for path in paths(given.small)]
    return AGREE if all(agree) else DIFFER


def check(path: Path, device: str) -> bool:
    """Prints a path's line; whether it agrees with the reference."""
    path.reference()  # compiles
    first = path.run(device)  # starts the device
    expected, reference_seconds = timed(path.reference)
    found, seconds = timed(lambda: path.run(device))
    off = difference(found, expected)
    same = all(np.array_equal(found[name], first[name]) for name in found)
    agrees = off <= path.tolerance
    verdict = "" if agrees else "  DIFFERS"
    again = "yes" if same else "no"
    print(f"{path.name} | {off:.1e} / {path.tolerance:g} | {again} | {reference_seconds:.3f} | {seconds:.3f}{verdict}")
    return agrees


def timed(work: Callable[[], Arrays]) -> tuple[Arrays, float]:
    """The arrays, which are on the host, so that the device has finished; and the seconds they took."""
    start = time.perf_counter()
    return work(), time.perf_counter() - start


def difference(found: Arrays, expected: Arrays) -> float:
    """Largest difference over the largest value of an array; infinite where names, shapes or NaN differ."""
    if found.keys() != expected.keys():
        return float("inf")
    worst = 0.0
    for name, one in expected.items():
        if found[name].shape != one.shape or not np.isfinite(found[name]).all():
            return float("inf")
        worst = max(worst, float(np.abs(found[name] - one).max() / max(np.abs(one).max(), 1e-12)))
    return worst


if __name__ == "__main__":
    raise SystemExit(main())
