"""Flow methods and validity thresholds on a shot with true flow and materials.

    python tests/benchmarks/temporal_flow.py SHOT_FOLDER

SHOT_FOLDER as for temporal_lambdas.py, with truth/flow.####.exr (forward.u, forward.v) and gbuffer.####.exr (depth.Z).
First table: seconds a pair in both directions, end-point error off occlusions (all, and within 4 pixels of the matte's
edge), RMSE and flicker after the solve over the noisy input's. Second: what each validity rejects, against true
occlusion (the point is hidden in the next frame by something 4 cm nearer) and against flow that is off by a pixel.
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from temporal_shots import STRENGTHS, ensemble, errors, load, read

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_validity, solve
from yesnt.temporal.flow import dense_flow, encode_grey

METHODS = ("dis-fast", "dis-medium", "dis-quality", "deepflow")
RULES = {
    "forward-backward 0.01, 0.5 (method.md)": FlowSettings(relative=0.01, absolute=0.5, photometric=np.inf),
    "forward-backward 0.05, 2": FlowSettings(photometric=np.inf),
    "colour 0.1": FlowSettings(relative=1e6, absolute=1e6),
    "both, colour 0.1": FlowSettings(photometric=0.1),
    "both, colour 0.05 (default)": FlowSettings(),
}


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

    def flows(self, method):
        grey = [encode_grey(plate, matte) for plate, matte in zip(self.plates, self.matte, strict=True)]
        started = time.perf_counter()
        both = [
            (dense_flow(grey[t], grey[t + 1], method), dense_flow(grey[t + 1], grey[t], method)) for t in self.pairs
        ]
        return both, (time.perf_counter() - started) / len(both)

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
    shot = Shot(Path(sys.argv[1]))
    still = np.zeros_like(shot.flow)
    print("method         s/pair    EPE  edge EPE   RMSE  flicker")
    for method in METHODS:
        both, seconds = shot.flows(method)
        error = [np.linalg.norm(both[t][0] - shot.flow[t], axis=-1) for t in shot.pairs]
        seen = [shot.matte[t] & ~shot.hidden[t] for t in shot.pairs]
        edge = [s & ~cv2.erode(m.astype(np.uint8), np.ones((9, 9))).astype(bool) for s, m in zip(seen, shot.matte)]  # noqa: B905
        means = [np.mean([e[s].mean() for e, s in zip(error, where, strict=True)]) for where in (seen, edge)]
        flow = np.stack([forward for forward, _ in both])
        rmse, flicker = shot.after(flow, shot.validity(both, FlowSettings()))
        print(f"{method:12s} {seconds:8.3f} {means[0]:6.3f} {means[1]:9.3f}  x{rmse:.3f}   x{flicker:.3f}", flush=True)
    for name, flow in (("true flow", shot.flow), ("no motion", still)):
        rmse, flicker = shot.after(flow, shot.validity([(f, None) for f in flow], FlowSettings()))
        print(f"{name:37s}  x{rmse:.3f}   x{flicker:.3f}", flush=True)
    both, _ = shot.flows("dis-quality")
    flow, inside = np.stack([forward for forward, _ in both]), shot.matte[:-1]
    hidden, wrong = np.stack(shot.hidden), inside & (np.linalg.norm(flow - shot.flow, axis=-1) > 1)
    print("\nvalidity of dis-quality               rejects   occlusion: recall precision   off by 1: recall precision")
    for name, settings in RULES.items():
        validity = shot.validity(both, settings)
        rejected = inside & (validity < 0.5)
        cells = [
            f"{(rejected & bad).sum() / bad.sum():8.2f} {(rejected & bad).sum() / rejected.sum():8.2f}"
            for bad in (hidden, wrong | hidden)
        ]
        rmse, flicker = shot.after(flow, validity)
        print(
            f"{name:38s} {rejected.sum() / inside.sum():6.3f}  {'     '.join(cells)}   x{rmse:.3f} x{flicker:.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
