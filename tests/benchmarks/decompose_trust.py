"""How far the expected roughness should leave the prior's mean: its error against the share, shot by shot.

python tests/benchmarks/decompose_trust.py FOLDER... [--weights FILE]

Each FOLDER holds plate.####.exr and truth/material.####.exr; its middle frame is judged, opacity above 0.99. What the
backend delivers is undone and drawn to the prior anew, so the share in use does not matter.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from decompose_accuracy import Regression, rmse

from yesnt.color import straighten
from yesnt.decompose.embedded import PRIOR_ROUGHNESS, TRUST, EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.weights import SHIPPED
from yesnt.io.exr import read_image

SHARES = (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0)


def judged(folder, backend):
    """Truth and what the reader itself expects of the roughness, [n] each."""
    paths = sorted(folder.rglob("plate.*.exr"))
    path = paths[len(paths) // 2]
    number = path.name.split(".")[1]
    plate = read_image(path).stack("RGBA")
    truth = read_image(next(folder.rglob(f"material.{number}.exr"))).stack(["roughness.Y"])[..., 0]
    rgb, matte = straighten(plate[..., :3], plate[..., 3]), plate[..., 3]
    mean = estimate_frame(rgb, matte, Regression(backend), EnsembleSettings(1), 0, int(number)).mean[0]
    inside = matte > 0.99
    return truth[inside], PRIOR_ROUGHNESS + (mean[inside] - PRIOR_ROUGHNESS) / TRUST


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, default=SHIPPED)
    options = parser.parse_args()
    torch.set_num_threads(1)
    backend, squares = EmbeddedBackend(options.weights), []
    print("share".ljust(20), *(f"{share:6.1f}" for share in SHARES), " constant")
    for folder in options.folders:
        truth, read = judged(folder, backend)
        errors = [rmse(PRIOR_ROUGHNESS + share * (read - PRIOR_ROUGHNESS) - truth) for share in SHARES]
        squares.append(np.square(errors))
        print(folder.name.ljust(20), *(f"{error:6.4f}" for error in errors), f"   {truth.std():6.4f}")
    print("root mean square".ljust(20), *(f"{error:6.4f}" for error in np.sqrt(np.mean(squares, 0))))


if __name__ == "__main__":
    main()
