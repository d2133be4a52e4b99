"""Errors of the embedded model on shots with ground truth, for several shrinkage factors of roughness.

python tests/benchmarks/decompose_auxiliary.py FOLDER... [--weights FILE] [--samples 8] [--picture OUT.png]

Each FOLDER holds plate.####.exr and truth/material.####.exr; its middle frame is evaluated where the opacity exceeds
0.99. Columns: RMSE of the predicted mean roughness for every value of `embedded.SHRINKAGE_FACTOR`, and of the best
constant of that shot; area under the curve of metallic (nan where there is only metal or none); rank correlation of
the ensemble's spread with its error, for roughness and metallic. The last row pools the errors, states the best single
roughness for all shots, and the means of the other columns.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch
from decompose_accuracy import Regression, area_under_curve, rmse, strip
from scipy.stats import spearmanr

from yesnt.core.color import straighten
from yesnt.decompose.embedded import PRIOR_ROUGHNESS, SHRINKAGE_FACTOR, EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.registry import EMBEDDED_WEIGHTS
from yesnt.decompose.settings import EnsembleSettings
from yesnt.io.pictures.image import read_image

FACTORS = (0.0, 0.6, 0.7, 0.8, 0.9, 1.0)


def middle(folder):
    """Plate, matte [H, W] and truth [H, W, 2] of the middle frame that has a truth, and its number."""
    paths = sorted(folder.rglob("material.*.exr"))
    path = paths[len(paths) // 2]
    number = path.name.split(".")[1]
    plate = read_image(next(folder.rglob(f"plate.{number}.exr"))).stack("RGBA")
    truth = read_image(path).stack(["roughness.Y", "metallic.Y"])
    return plate, plate[..., 3], truth, int(number)


def evaluate(folder, backend, samples):
    """Figures of a folder, its truth of roughness, and a picture of it."""
    plate, matte, truth, number = middle(folder)
    rgb, inside = straighten(plate[..., :3], matte), matte > 0.99
    read = estimate_frame(rgb, matte, Regression(backend), EnsembleSettings(1), 0, number).mean
    drawn = estimate_frame(rgb, matte, backend, EnsembleSettings(samples), 0, number)
    rough, metal = truth[inside].T
    free = PRIOR_ROUGHNESS + (read[0][inside] - PRIOR_ROUGHNESS) / SHRINKAGE_FACTOR
    figures = [rmse(PRIOR_ROUGHNESS + factor * (free - PRIOR_ROUGHNESS) - rough) for factor in FACTORS]
    figures += [rough.std(), area_under_curve(read[1][inside], metal > 0.5)]
    error = np.abs(drawn.mean[:, inside] - [rough, metal])
    figures += [spearmanr(drawn.std[p][inside], error[p]).statistic for p in (0, 1)]
    return figures, rough, strip(plate[..., :3], truth.transpose(2, 0, 1) * matte, drawn.mean, drawn.std)


def summary(name, rows, roughness):
    """Root mean squares of the errors, means of the rest, and the error of one roughness for all."""
    rows = np.array(rows)
    count = len(FACTORS)
    errors = np.sqrt(np.mean(rows[:, :count] ** 2, 0))
    best = np.mean([r.mean() for r in roughness])  # every shot counts alike
    constant = np.sqrt(np.mean([np.mean((r - best) ** 2) for r in roughness]))
    show(name, [*errors, constant, *np.nanmean(rows[:, count + 1 :], 0)])


def show(name, figures):
    print(name.ljust(22), *(f"{figure:7.4f}" for figure in figures))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, default=EMBEDDED_WEIGHTS)
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    backend, rows, truths = EmbeddedBackend(options.weights, steps=2), [], []
    titles = (*(f"{factor:.1f}" for factor in FACTORS), "const", "auc", "rank r", "rank m")
    print("factor".ljust(22), *(title.rjust(7) for title in titles))
    for folder in options.folders:
        figures, rough, picture = evaluate(folder, backend, options.samples)
        rows.append(figures)
        truths.append(rough)
        show(folder.name, figures)
        if options.picture:
            pixels = (picture * 255).clip(0, 255).astype(np.uint8)
            cv2.imwrite(str(options.picture.with_stem(f"{options.picture.stem}_{folder.name}")), pixels[..., ::-1])
    if len(rows) > 1:
        summary("all, pooled", rows, truths)


if __name__ == "__main__":
    main()
