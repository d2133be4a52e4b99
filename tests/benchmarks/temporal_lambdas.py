"""Chooses the energy's defaults: accuracy and flicker over lambda1, lambda2 and delta on a shot with true materials.

    python tests/benchmarks/temporal_lambdas.py SHOT_FOLDER [--out OUT_FOLDER]

SHOT_FOLDER holds plate.####.exr and truth/material.####.exr. Noise of an ensemble is added to the true materials at
three strengths (a smooth error that members share, a smooth and a white one of each member, an offset of each frame).
Writes temporal-sweep.json and temporal-sweep.svg (kept in docs/): RMSE to the truth against RMSE of the frame-to-frame
difference, both over the noisy input's, one point per setting, mean of channels, strengths and seeds.
"""

import argparse
import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import OpenEXR

from yesnt.temporal import EnergyParams, FlowSettings, flow_and_validity, solve

LAMBDA1, LAMBDA2, DELTA = (0.003, 0.005, 0.01, 0.02), (1.0, 2.0, 3.0, 5.0), (0.05, 0.1, 0.2)
STRENGTHS, MEMBERS = (0.02, 0.05, 0.1), 4


def read(path):
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(channel.pixels, np.float32) for name, channel in channels.items()}


def load(folder):
    """Straight plate [T, H, W, 3], matte [T, H, W], true (roughness, metallic) [2, T, H, W]."""
    plates, mattes, truths = [], [], []
    for path in sorted(folder.glob("plate.*.exr")):
        plate = read(path)
        opacity = np.maximum(plate["A"], 1e-3)
        material = read(folder / "truth" / path.name.replace("plate", "material"))
        plates.append(np.stack([plate[c] for c in "RGB"], -1) / opacity[..., None])
        mattes.append(plate["A"] > 0.5)
        truths.append(np.stack([material[name] / opacity for name in ("roughness.Y", "metallic.Y")]))
    return np.stack(plates), np.stack(mattes), np.stack(truths, 1).astype(np.float32)


def smooth_noise(rng, shape, radius, strength):
    noise = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), radius)
    return noise * strength / noise.std()


def ensemble(truth, strength, seed):
    """Mean and confidence [2, T, H, W] of noisy members."""
    rng, mean, confidence = np.random.default_rng(seed), np.zeros_like(truth), np.zeros_like(truth)
    for plane in np.ndindex(truth.shape[:2]):
        shared = smooth_noise(rng, truth.shape[2:], 8, 0.6 * strength)
        members = [
            truth[plane]
            + shared
            + smooth_noise(rng, truth.shape[2:], 5, strength)
            + 0.3 * strength * (rng.standard_normal(truth.shape[2:]) + rng.standard_normal())
            for _ in range(MEMBERS)
        ]
        members = np.clip(members, 0, 1)
        mean[plane], confidence[plane] = members.mean(0), 1 - np.clip(members.std(0) / 0.5, 0, 1)
    return mean, confidence


def errors(value, truth, matte):
    """RMSE to the truth and RMSE of the frame-to-frame difference, [2 channels, 2]."""
    both, difference = matte[1:] & matte[:-1], np.diff(value - truth, axis=1)
    return np.array(
        [
            (np.sqrt(np.mean((v - t)[matte] ** 2)), np.sqrt(np.mean(d[both] ** 2)))
            for v, t, d in zip(value, truth, difference, strict=True)
        ]
    )


def sweep(folder, settings):
    plates, matte, truth = load(folder)
    pairs = [
        flow_and_validity(plates[t], plates[t + 1], matte[t], matte[t + 1], FlowSettings())
        for t in range(len(plates) - 1)
    ]
    flow, validity = (np.stack(parts) for parts in zip(*pairs, strict=True))
    inputs = [ensemble(truth, strength, seed) for strength in STRENGTHS for seed in (1, 2)]
    before = [errors(mean, truth, matte) for mean, _ in inputs]
    rows = []
    for lambda1, lambda2, delta in settings:
        params, ratios = EnergyParams(delta=delta, lambda1=lambda1, lambda2=lambda2), []
        for (mean, confidence), noisy in zip(inputs, before, strict=True):
            value = solve(mean, confidence, flow, validity, params, matte, tolerance=1e-3).value
            ratios.append(errors(value, truth, matte) / noisy)
        ratio = np.array(ratios).reshape(len(STRENGTHS), 2, 2, 2).mean(axis=1)
        rows.append(
            {
                "lambda1": lambda1,
                "lambda2": lambda2,
                "delta": delta,
                "strength_channel_rmse_diff": ratio.round(4).tolist(),
            }
        )
        rmse, difference = ratio.mean(axis=(0, 1))
        worst = ratio.reshape(-1, 2).max(axis=0)
        print(
            f"{lambda1:6} {lambda2:5} {delta:5}  rmse x{rmse:.3f} diff x{difference:.3f}  worst {worst.round(2)}",
            flush=True,
        )
    return rows


def plot(rows):
    """An SVG scatter: colour is lambda2, radius lambda1, the default ringed."""
    colours = dict(zip(LAMBDA2, ("#4e79a7", "#59a14f", "#e15759", "#b07aa1"), strict=True))
    points, default = [], EnergyParams()
    for row in rows:
        rmse, difference = np.mean(row["strength_channel_rmse_diff"], axis=(0, 1))
        x, y = 60 + 900 * (rmse - 0.5), 420 - 900 * (difference - 0.15)
        radius = 2 + 60 * row["lambda1"] ** 0.7
        chosen = (row["lambda1"], row["lambda2"], row["delta"]) == (default.lambda1, default.lambda2, default.delta)
        ring = ' stroke="black" stroke-width="2"' if chosen else ""
        points.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="{colours[row["lambda2"]]}"{ring}/>')
    legend = [
        f'<text x="420" y="{30 + 18 * i}" fill="{colour}">lambda2 = {value}</text>'
        for i, (value, colour) in enumerate(colours.items())
    ]
    labels = '<text x="60" y="445">RMSE over input, 0.5 .. 1</text><text x="5" y="15">flicker over input</text>'
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="560" height="460" font-family="sans-serif" font-size="13">'
    return "\n".join([head, '<rect width="560" height="460" fill="white"/>', *points, *legend, labels, "</svg>"])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shot", type=Path)
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    rows = sweep(options.shot, itertools.product(LAMBDA1, LAMBDA2, DELTA))
    (options.out / "temporal-sweep.json").write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
    (options.out / "temporal-sweep.svg").write_text(plot(rows))


if __name__ == "__main__":
    main()
