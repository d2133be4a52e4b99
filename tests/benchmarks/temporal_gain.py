"""What the temporal stage does to the embedded model's materials: accuracy and stability, before and after.

    python tests/benchmarks/temporal_gain.py SHOT ... [--work FOLDER] [--strip PICTURE.png]

A SHOT holds plate.####.exr and truth/material.####.exr. Inputs are what the embedded model predicts (kept in --work,
made again when weights change); flow, validity and trust are the stage's defaults. For roughness and metallic: RMSE to
the truth, RMSE of the frame-to-frame difference, and tPSNR-diff = PSNR(x_{t+1} - x_t, g_{t+1} - g_t) over pixels that
are matte in both frames, each before > after. --strip draws, for each shot, the row with the widest matte over time:
roughness before, after and true, time downwards, each frame eight pixels high.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from temporal_shots import errors, load, predicted

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, bridged_links, flow_and_validity, robust_confidence, solve

HEIGHT, GAP = 8, 8


def solved(plates, matte, mean, std):
    """The stage on one shot at its defaults: [2, T, H, W]."""
    pairs = [
        flow_and_validity(plates[t], plates[t + 1], matte[t], matte[t + 1], FlowSettings())
        for t in range(len(plates) - 1)
    ]
    flow, validity = (np.stack(parts) for parts in zip(*pairs, strict=True))
    weight, report = robust_confidence(mean, confidence(std), flow, validity, matte)
    links = bridged_links(validity, report.frames)
    return solve(mean, weight, flow, links, EnergyParams(), matte, silent=report.frames).value


def psnr(rmse):
    return -20 * np.log10(rmse)


def report(name, before, after, truth, matte):
    old, new = errors(before, truth, matte), errors(after, truth, matte)
    for channel, a, b in zip(("roughness", "metallic"), old, new, strict=True):
        print(
            f"{name:8s} {channel:10s} RMSE {a[0]:.4f} > {b[0]:.4f} (x{b[0] / a[0]:.3f})  difference {a[1]:.4f} > "
            f"{b[1]:.4f} (x{b[1] / a[1]:.3f})  tPSNR-diff {psnr(a[1]):.2f} > {psnr(b[1]):.2f} dB",
            flush=True,
        )


def strip(planes, matte):
    """[rows, columns] 8 bit: one row of each plane [T, H, W] over time, side by side; grey outside the matte."""
    row = int(matte.sum(axis=(0, 2)).argmax())
    columns = np.flatnonzero(matte[:, row].any(axis=0))
    part = slice(int(columns[0]), int(columns[-1]) + 1)
    cells = [np.where(matte[:, row, part], np.clip(plane[:, row, part], 0, 1), 0.5) for plane in planes]
    cells = [np.repeat(np.repeat((255 * cell).astype(np.uint8), HEIGHT, 0), 2, 1) for cell in cells]
    wall = np.full((cells[0].shape[0], GAP), 255, np.uint8)
    return np.hstack([cells[0], wall, cells[1], wall, cells[2]])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--work", type=Path, default=Path("temporal-sweep"))
    parser.add_argument("--strip", type=Path)
    options = parser.parse_args()
    started, strips = time.perf_counter(), []
    for folder in options.shots:
        plates, matte, truth = load(folder)
        mean, std = predicted(folder, options.work)
        value = solved(plates, matte, mean, std)
        report(folder.name, mean, value, truth, matte)
        strips.append(strip((mean[0], value[0], truth[0]), matte))
    if options.strip is not None:
        width = max(part.shape[1] for part in strips)
        padded = [np.pad(part, ((0, GAP), (0, width - part.shape[1])), constant_values=255) for part in strips]
        cv2.imwrite(str(options.strip), np.vstack(padded))
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
