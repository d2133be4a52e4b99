"""Flow methods on shots with true flow and materials; thresholds of validity are temporal_validity.py's.

    python tests/benchmarks/temporal_flow.py SHOT ... [--weights SPYNET_FILE]

A SHOT holds plate.####.exr, gbuffer.####.exr (depth.Z), truth/material.####.exr and truth/flow.####.exr (forward.u,
forward.v). For each method: processor seconds a pair in both directions, end-point error where the point is seen in the
next frame (all, and within 4 pixels of the matte's edge), RMSE and RMSE of the frame-to-frame difference after the
solve of noisy true materials, over the noisy input's. With weights the learned flow is among them.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from temporal_shots import STRENGTHS, ensemble, errors, load, read

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_validity, solve
from yesnt.temporal.flow import dense_flow, encode_colour, encode_grey
from yesnt.temporal.spynet import open_spynet

METHODS = ("dis-fast", "dis-medium", "dis-quality", "deepflow")


def occluded(depth, next_depth, flow, matte, next_matte):
    """[H, W] matte points that the next frame does not show."""
    height, width = matte.shape
    row, column = np.mgrid[0:height, 0:width]
    x, y = np.rint(column + flow[..., 0]).astype(int), np.rint(row + flow[..., 1]).astype(int)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    farthest = cv2.dilate(np.where(next_matte, next_depth, 0), np.ones((3, 3)))
    return matte & (~inside | ~next_matte[y, x] | (farthest[y, x] < depth - 0.04))


class Shot:
    def __init__(self, folder):
        self.plates, self.matte, self.truth = load(folder)
        gbuffers, flows = sorted(folder.glob("gbuffer.*.exr")), sorted((folder / "truth").glob("flow.*.exr"))
        depth = [read(path)["depth.Z"] for path in gbuffers]
        channels = [read(path) for path in flows]
        self.flow = np.stack([np.stack([c["forward.u"], c["forward.v"]], -1) for c in channels])[:-1]
        self.pairs = range(len(self.plates) - 1)
        mattes = [(self.matte[t], self.matte[t + 1]) for t in self.pairs]
        self.hidden = [occluded(depth[t], depth[t + 1], self.flow[t], *mattes[t]) for t in self.pairs]

    def flows(self, method, learned=None):
        """Flow there and back of each pair, and processor seconds a pair."""
        encode = encode_grey if learned is None else encode_colour
        pictures = [encode(plate, matte) for plate, matte in zip(self.plates, self.matte, strict=True)]
        match = learned or (lambda one, other: dense_flow(one, other, method))
        started = time.process_time()
        both = [(match(pictures[t], pictures[t + 1]), match(pictures[t + 1], pictures[t])) for t in self.pairs]
        return both, (time.process_time() - started) / len(both)

    def validity(self, both, settings):
        pair = [(self.plates[t], self.plates[t + 1], self.matte[t], self.matte[t + 1]) for t in self.pairs]
        return np.stack([flow_validity(*both[t], *pair[t], settings) for t in self.pairs])

    def after(self, flow, validity):
        """RMSE and flicker over the input's, mean over strengths and channels."""
        ratios = []
        for strength in STRENGTHS:
            mean, std = ensemble(self.truth, strength, 3)
            value = solve(mean, confidence(std), flow, validity, EnergyParams(), self.matte, tolerance=1e-3).value
            ratios.append(errors(value, self.truth, self.matte) / errors(mean, self.truth, self.matte))
        return np.mean(ratios, axis=(0, 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    for folder in options.shots:
        shot = Shot(folder)
        print(f"{folder.name:14s} s/pair    EPE  edge EPE   RMSE  difference")
        for method in METHODS:
            report(shot, method, *shot.flows(method))
        if options.weights is not None:
            report(shot, "spynet", *shot.flows("spynet", open_spynet(options.weights)))
        for name, flow in (("true flow", shot.flow), ("no motion", np.zeros_like(shot.flow))):
            rmse, difference = shot.after(flow, shot.validity([(f, None) for f in flow], FlowSettings()))
            print(f"{name:37s}  x{rmse:.3f}   x{difference:.3f}", flush=True)


def report(shot, name, both, seconds):
    error = [np.linalg.norm(both[t][0] - shot.flow[t], axis=-1) for t in shot.pairs]
    seen = [shot.matte[t] & ~shot.hidden[t] for t in shot.pairs]
    edges = [cv2.erode(matte.astype(np.uint8), np.ones((9, 9))) == 0 for matte in shot.matte[:-1]]
    near = [s & edge for s, edge in zip(seen, edges, strict=True)]
    means = [np.mean([e[s].mean() for e, s in zip(error, where, strict=True)]) for where in (seen, near)]
    rmse, difference = shot.after(np.stack([f for f, _ in both]), shot.validity(both, FlowSettings()))
    print(f"{name:12s} {seconds:8.3f} {means[0]:6.3f} {means[1]:9.3f}  x{rmse:.3f}   x{difference:.3f}", flush=True)


if __name__ == "__main__":
    main()
