"""Sampling that stops against a fixed number of members: network evaluations and error on a shot with truth.

python tests/benchmarks/decompose_adaptive.py FOLDER [--frames 3] [--weights FILE]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from yesnt.color import straighten
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.weights import SHIPPED
from yesnt.io.exr import read_image

CASES = (
    ("K=16", EnsembleSettings(16)),
    ("K=8", EnsembleSettings(8)),
    ("K=4", EnsembleSettings(4)),
    ("K=2", EnsembleSettings(2)),
    ("tolerance 0.02", EnsembleSettings(16, tolerance=0.02)),
    ("tolerance 0.03", EnsembleSettings(16, tolerance=0.03)),
    ("tolerance 0.05", EnsembleSettings(16, tolerance=0.05)),
    ("tolerance 0.08", EnsembleSettings(16, tolerance=0.08)),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--weights", type=Path, default=SHIPPED)
    options = parser.parse_args()
    torch.set_num_threads(1)
    plates = sorted(options.folder.glob("plate.*.exr"))
    chosen = [plates[i] for i in np.unique(np.linspace(0, len(plates) - 1, options.frames).astype(int))]
    print(f"{'case':16s} steps  evaluations  ratio  rmse roughness  metallic  seconds/frame")
    for steps in (1, 2):
        backend, whole = EmbeddedBackend(options.weights, steps), None
        for name, settings in CASES:
            squares, evaluations, start = [], 0, time.process_time()
            for path in chosen:
                number = path.name.split(".")[1]
                plate = read_image(path).stack("RGBA")
                truth = read_image(options.folder / "truth" / f"material.{number}.exr")
                truth = np.stack([truth.channels["roughness.Y"], truth.channels["metallic.Y"]])
                rgb, matte = straighten(plate[..., :3], plate[..., 3]), plate[..., 3]
                estimate = estimate_frame(rgb, matte, backend, settings, 0, int(number))
                squares.append(((estimate.mean - truth) ** 2)[:, matte > 0.99])
                evaluations += estimate.total_evaluations
            error = np.sqrt(np.concatenate(squares, 1).mean(1))
            seconds = (time.process_time() - start) / len(chosen)
            whole = whole or evaluations
            print(
                f"{name:16s} {steps:5d}  {evaluations / len(chosen):11.0f}  {whole / evaluations:5.1f}"
                f"  {error[0]:14.4f}  {error[1]:8.4f}  {seconds:8.2f}"
            )


if __name__ == "__main__":
    main()
