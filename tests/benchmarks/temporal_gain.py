"""What the temporal stage does to the embedded model's materials: accuracy and stability, before and after.

    python tests/benchmarks/temporal_gain.py SHOT ... [--work FOLDER] [--oracles] [--strip PICTURE.png]

A SHOT holds plate.####.exr, gbuffer.####.exr (depth.Z), truth/material.####.exr and truth/flow.####.exr. Inputs are
what the embedded model predicts (kept in --work, made again when weights change); flow, validity and trust are the
stage's defaults. For roughness and metallic, each before > after:

- RMSE to the truth;
- difference: RMSE of the frame-to-frame difference, x_{t+1} - x_t - (g_{t+1} - g_t), at pixels that are matte in both
  frames, and tPSNR-diff, the same in dB. It counts flicker, and detail that the prediction lacks moving past a pixel;
- along: RMS of x_{t+1}(p + f) - x_t(p), f the true flow, where the point is truly seen in both frames. It counts
  flicker alone; the truth's own (its texture, sampled between pixels) is told beside it.

--oracles tells how far the difference could fall, as a share of the input's: for a prediction that never changes
(still), for the truth blurred until it is as flat as the result (blurred), and for the prediction tied fast to itself
along the true flow, which keeps its accuracy and flickers no more (steady; its RMSE follows); and what is left along
the true flow of the steady one, and of a solve without links in time (unlinked: what smoothing in space does to it).
--strip draws, for each shot, the row with the widest matte over time: roughness before, after and true, time downwards,
each frame eight pixels high.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from temporal_flow import Shot
from temporal_shots import errors, predicted

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_and_validity, robust_confidence, solve, solve_bridged
from yesnt.temporal.flow import sample_next

HEIGHT, GAP = 8, 8
CHANNELS = ("roughness", "metallic")
TIED = EnergyParams(lambda1=0.0, lambda2=100.0)
SIGMAS = np.geomspace(0.5, 64, 29)


def solved(plates, matte, mean, std):
    """The stage on one shot at its defaults: [2, T, H, W], and the weight of what was predicted."""
    pairs = [
        flow_and_validity(plates[t], plates[t + 1], matte[t], matte[t + 1], FlowSettings())
        for t in range(len(plates) - 1)
    ]
    flow, validity = (np.stack(parts) for parts in zip(*pairs, strict=True))
    weight, report = robust_confidence(mean, confidence(std), flow, validity, matte)
    return solve_bridged(mean, weight, flow, validity, report.frames, EnergyParams(), matte).value, weight


def psnr(rmse):
    return -20 * np.log10(rmse)


def along(value, shot):
    """RMS of [2, T, H, W] from frame to frame along the true flow, where the point is seen in both frames: [2]."""
    parts = []
    for t in shot.pairs:
        here, following = (np.moveaxis(value[:, k], 0, -1) for k in (t, t + 1))
        fetched, valid = sample_next(following, shot.flow[t], shot.matte[t], shot.matte[t + 1])
        parts.append((fetched - here)[valid & ~shot.hidden[t]])
    return np.sqrt(np.mean(np.concatenate(parts).astype(float) ** 2, axis=0))


def report(name, before, after, shot):
    old, new = errors(before, shot.truth, shot.matte), errors(after, shot.truth, shot.matte)
    old, new = (np.column_stack([e, along(v, shot)]) for e, v in ((old, before), (new, after)))
    own = along(shot.truth, shot)
    for k, channel in enumerate(CHANNELS):
        cells = [
            f"{what} {a:.4f} > {b:.4f} (x{b / a:.3f})"
            for what, a, b in zip(("RMSE", "difference", "along"), old[k], new[k], strict=True)
        ]
        decibels = f"tPSNR-diff {psnr(old[k, 1]):.2f} > {psnr(new[k, 1]):.2f} dB"
        print(f"{name:8s} {channel:10s}", *cells, f"(truth {own[k]:.4f})", decibels, sep="  ", flush=True)


def oracles(name, before, after, weight, shot):
    """How far the difference could fall; see above."""
    rmse, difference = errors(before, shot.truth, shot.matte).T
    still = errors(np.zeros_like(before), shot.truth, shot.matte)[:, 1]
    flat = [blur_to(after[k], shot.truth[k], shot.matte) for k in range(len(CHANNELS))]
    low = errors(np.stack([plane for plane, _ in flat]), shot.truth, shot.matte)[:, 1]
    seen = np.stack([shot.matte[t] & ~shot.hidden[t] for t in shot.pairs]).astype(np.float32)
    tied = solve(before, weight, shot.flow, seen, TIED, shot.matte).value
    independent = solve(before, weight, shot.flow, 0 * seen, EnergyParams(), shot.matte).value
    steady = errors(tied, shot.truth, shot.matte)
    left, unlinked = (along(value, shot) / along(before, shot) for value in (tied, independent))
    for k, channel in enumerate(CHANNELS):
        print(
            f"{name:8s} {channel:10s}  difference could fall to: still x{still[k] / difference[k]:.3f}  blurred "
            f"x{low[k] / difference[k]:.3f} (sigma {flat[k][1]:.1f})  steady x{steady[k, 1] / difference[k]:.3f} "
            f"(RMSE x{steady[k, 0] / rmse[k]:.3f})  along: steady x{left[k]:.3f}  unlinked x{unlinked[k]:.3f}",
            flush=True,
        )


def blur_to(value, truth, matte):
    """The truth [T, H, W] blurred within the matte until neighbours differ as little as those of `value`; and sigma."""
    aim = roughening(value, matte)
    for sigma in SIGMAS:
        plane = np.stack([blurred(frame, mask, sigma) for frame, mask in zip(truth, matte, strict=True)])
        if roughening(plane, matte) <= aim:
            break
    return plane, sigma


def blurred(frame, mask, sigma):
    """Gauss's mean of the masked pixels."""
    total, count = (cv2.GaussianBlur(part.astype(np.float32), (0, 0), sigma) for part in (frame * mask, mask))
    return np.where(mask, total / np.maximum(count, 1e-6), frame)


def roughening(planes, matte):
    """RMS difference of horizontal and vertical neighbours that are both matte."""
    down, right = np.diff(planes, axis=1), np.diff(planes, axis=2)
    found = [down[matte[:, 1:] & matte[:, :-1]], right[matte[..., 1:] & matte[..., :-1]]]
    return np.sqrt(np.mean(np.concatenate(found) ** 2))


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
    parser.add_argument("--oracles", action="store_true")
    parser.add_argument("--strip", type=Path)
    options = parser.parse_args()
    started, strips = time.perf_counter(), []
    for folder in options.shots:
        shot = Shot(folder)
        mean, std = predicted(folder, options.work)
        value, weight = solved(shot.plates, shot.matte, mean, std)
        report(folder.name, mean, value, shot)
        if options.oracles:
            oracles(folder.name, mean, value, weight, shot)
        strips.append(strip((mean[0], value[0], shot.truth[0]), shot.matte))
    if options.strip is not None:
        width = max(part.shape[1] for part in strips)
        padded = [np.pad(part, ((0, GAP), (0, width - part.shape[1])), constant_values=255) for part in strips]
        cv2.imwrite(str(options.strip), np.vstack(padded))
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
