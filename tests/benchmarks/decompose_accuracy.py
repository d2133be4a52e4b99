"""Accuracy and calibration of the embedded model on a shot with truth.

python tests/benchmarks/decompose_accuracy.py FOLDER [--samples 8] [--frames 4] [--weights FILE] [--picture OUT.png]

FOLDER holds plate.####.exr (associated RGBA) and truth/material.####.exr (roughness.Y, metallic.Y). Pixels of opacity
above 0.99 count. The best constant is the mean of the truth over the shot, which no method may know.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from scipy.stats import rankdata, spearmanr

from yesnt.core.color import srgb_encode, straighten
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.registry import EMBEDDED_WEIGHTS
from yesnt.decompose.settings import EnsembleSettings
from yesnt.io.pictures.image import read_image

BINS = (0.0, 0.3, 0.45, 0.6, 0.75, 0.9, 1.01)


def rmse(error):
    return float(np.sqrt(np.mean(np.square(error))))


def area_under_curve(score, positive):
    """Probability that a metal pixel scores above a non-metal one (Mann-Whitney)."""
    n, m = int(positive.sum()), int((~positive).sum())
    if n == 0 or m == 0:
        return float("nan")
    return float((rankdata(score)[positive].sum() - n * (n + 1) / 2) / (n * m))


def sparsification(error, std):
    """Area between the RMSE curve when the least certain pixels go first and the oracle's, over the whole RMSE."""
    kept = np.linspace(0, 0.95, 20)

    def curve(order):
        squares = np.square(error)[order]
        return np.array([np.sqrt(squares[int(k * len(squares)) :].mean()) for k in kept])

    by_std, oracle = curve(np.argsort(-std, kind="stable")), curve(np.argsort(-np.abs(error), kind="stable"))
    return float(np.mean(by_std - oracle) / max(by_std[0], 1e-9))


class Regression:
    """The predicted mean alone, without samples: a regression network of the same size."""

    def __init__(self, backend):
        self._backend = backend

    def __getattr__(self, name):
        if name == "predict_mean":  # the sample mean is used, which here is the predicted mean
            raise AttributeError(name)
        return getattr(self._backend, name)

    def sample(self, condition, noise):
        return self._backend.predict_mean(condition)


def measure(truth, mean, std):
    """Figures over all pixels; every array [2, n]."""
    error = mean - truth
    constant = truth - truth.mean(1, keepdims=True)
    figures = {}
    for plane, name in enumerate(("roughness", "metallic")):
        figures[name] = {
            "rmse": rmse(error[plane]),
            "best_constant": rmse(constant[plane]),
            "ratio": rmse(error[plane]) / max(rmse(constant[plane]), 1e-9),
            "bias": float(error[plane].mean()),
            "std_mean": float(std[plane].mean()),
            "std_rms_over_rmse": float(np.sqrt(np.mean(std[plane] ** 2)) / max(rmse(error[plane]), 1e-9)),
            "spearman": float(spearmanr(std[plane], np.abs(error[plane])).statistic),
            "sparsification": sparsification(error[plane], std[plane]),
        }
    figures["metallic"]["auc"] = area_under_curve(mean[1], truth[1] > 0.5)
    figures["roughness_bias_by_truth"] = {
        f"{low:.2f}-{high:.2f}": [round(float(error[0][inside].mean()), 3), int(inside.sum())]
        for low, high in pairwise(BINS)
        if (inside := (truth[0] >= low) & (truth[0] < high)).any()
    }
    return figures


def strip(rgb, truth, mean, std):
    grey = [
        np.repeat(plane[..., None], 3, 2) for plane in (truth[0], mean[0], 2 * std[0], truth[1], mean[1], 2 * std[1])
    ]
    return np.concatenate([srgb_encode(rgb), *grey], 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument("--tolerance", type=float, default=0.0)
    parser.add_argument("--frames", type=int, default=4, help="how many, spread over the shot")
    parser.add_argument("--weights", type=Path, default=EMBEDDED_WEIGHTS)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    backend = EmbeddedBackend(options.weights, options.steps)
    settings = EnsembleSettings(options.samples, tolerance=options.tolerance)
    plates = sorted(options.folder.glob("plate.*.exr"))
    chosen = [plates[i] for i in np.unique(np.linspace(0, len(plates) - 1, options.frames).astype(int))]
    parts, strips, seconds, nfe, regressed = [], [], [], [], []
    for path in chosen:
        number = path.name.split(".")[1]
        plate = read_image(path).stack("RGBA")
        truth = read_image(options.folder / "truth" / f"material.{number}.exr").stack(["roughness.Y", "metallic.Y"])
        rgb, matte = straighten(plate[..., :3], plate[..., 3]), plate[..., 3]
        start = time.perf_counter()
        estimate = estimate_frame(rgb, matte, backend, settings, 0, int(number))
        seconds.append(time.perf_counter() - start)
        nfe.append(estimate.total_nfe)
        alone = estimate_frame(rgb, matte, Regression(backend), EnsembleSettings(1), 0, int(number))
        inside = matte > 0.99
        regressed.append(alone.mean[:, inside] - truth[inside].T)
        parts.append([truth[inside].T, estimate.mean[:, inside], estimate.std[:, inside]])
        strips.append(strip(plate[..., :3], truth.transpose(2, 0, 1) * matte, estimate.mean, estimate.std))
    figures = measure(*(np.concatenate(group, 1) for group in zip(*parts, strict=True)))
    for plane, name in zip(np.concatenate(regressed, 1), ("roughness", "metallic"), strict=True):
        figures[name]["rmse_of_the_regression"] = rmse(plane)
    figures["seconds_per_frame"], figures["evaluations_per_frame"] = (
        float(np.median(seconds)),
        float(np.mean(nfe)),
    )
    if options.picture:
        picture = (np.concatenate(strips[:2]) * 255).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(options.picture), picture[..., ::-1])
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
