"""Chooses the energy's defaults: accuracy and flicker over lambda1, lambda2, delta and the confidence's divisor.

    python tests/benchmarks/temporal_lambdas.py SHOT ... --held-out SHOT ... [--work FOLDER] [--out FOLDER]

A SHOT holds plate.####.exr, gbuffer.####.exr, truth/material.####.exr and truth/flow.####.exr (docs/stage.md). Inputs
are what the embedded model predicts for it (kept in --work, made again when weights change) and an ensemble's noise on
the true materials (a smooth error that members share, a smooth and a white one of each member, an offset of each
frame). All goes through the stage's own flow, validity and robust confidence 1 - std / divisor. What is measured is
kept in --work: a run that was cut off goes on.

Writes temporal-sweep.json and temporal-sweep.svg (kept in docs/): RMSE to the truth, RMSE of the frame-to-frame
difference at fixed pixels, and RMS of what changes along the true flow (temporal_gain.py), over the input's, for each
shot, input and channel. The shots before --held-out choose: of the settings in which no channel of any input becomes
less accurate and each flickers a fifth less along the true flow, the one with the least mean of all ratios. Held-out
shots are then measured with it, and with the defaults.
"""

import argparse
import hashlib
import itertools
import json
import time
from pathlib import Path

import numpy as np
from temporal_flow import Shot as TrueShot
from temporal_gain import along
from temporal_shots import ensemble, errors, predicted

from yesnt.decompose.confidence import DIVISOR as DIVISOR_USED
from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_and_validity, robust_confidence, solve

LAMBDA1, LAMBDA2, DELTA = (0.0025, 0.005, 0.01, 0.015, 0.04), (1.0, 2.0, 4.0), (0.1,)
DIVISOR = (1.5, 3.0)
NAMES = ("lambda1", "lambda2", "delta", "divisor")
NOISE = 0.05
COLOURS = ("#4e79a7", "#59a14f", "#e15759")
PREDICTED = "predicted"


class Shot:
    """Links and inputs of one shot, and what was measured on them."""

    def __init__(self, folder, work):
        self.name = folder.name
        self.true = TrueShot(folder)
        plates, self.matte, self.truth = self.true.plates, self.true.matte, self.true.truth
        pairs = [
            flow_and_validity(plates[t], plates[t + 1], self.matte[t], self.matte[t + 1], FlowSettings())
            for t in self.true.pairs
        ]
        self.links = tuple(np.stack(parts) for parts in zip(*pairs, strict=True))
        given = {PREDICTED: predicted(folder, work), f"noise {NOISE}": ensemble(self.truth, NOISE, 1)}
        ones = np.ones_like(self.truth)
        self.inputs = {
            name: (mean, std, robust_confidence(mean, ones, *self.links, self.matte)[0])
            for name, (mean, std) in given.items()
        }
        arrays = (*self.links, *(array for group in self.inputs.values() for array in group))
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).data for array in arrays)).hexdigest()
        self._book = work / f"{self.name}.{digest[:16]}.along.json"
        self._known = json.loads(self._book.read_text()) if self._book.exists() else {}

    def ratios(self, setting):
        """Input -> [channel, (RMSE, difference, along)] over the input's own."""
        key = " ".join(map(str, setting))
        if key not in self._known:
            lambda1, lambda2, delta, divisor = setting
            params = EnergyParams(delta=delta, lambda1=lambda1, lambda2=lambda2)
            self._known[key] = {name: self._ratio(name, params, divisor) for name in self.inputs}
            self._book.write_text(json.dumps(self._known))
        return self._known[key]

    def _ratio(self, name, params, divisor):
        mean, std, trust = self.inputs[name]
        value = solve(mean, confidence(std, divisor) * trust, *self.links, params, self.matte, tolerance=1e-3).value
        ratio = self._measures(value) / self._measures(mean)
        return ratio.astype(np.float64).round(4).tolist()

    def _measures(self, value):
        return np.column_stack([errors(value, self.truth, self.matte), along(value, self.true)])


def sweep(shots, settings):
    rows = []
    for setting in settings:
        row = dict(zip(NAMES, setting, strict=True))
        rows.append(row | {"shots": {shot.name: shot.ratios(setting) for shot in shots}})
        told = [f"{name} {np.array(found[PREDICTED]).round(2).tolist()}" for name, found in rows[-1]["shots"].items()]
        print(*setting, f"cost {cost(rows[-1]):.3f}", *told, flush=True)
    return rows


def cost(row):
    """Mean of the three ratios over shots and channels; predictions weigh as much as all noises together."""
    return float(np.mean([_cost(inputs) for inputs in row["shots"].values()]))


def _cost(inputs):
    noises = [ratio for name, ratio in inputs.items() if name != PREDICTED]
    return 0.5 * np.mean(inputs[PREDICTED]) + 0.5 * np.mean(noises)


def safe(row):
    """Whether no channel of any input became less accurate, and each flickers less by a fifth."""
    found = np.array([ratio for inputs in row["shots"].values() for ratio in inputs.values()])
    return bool(found[..., 0].max() <= 1 and found[..., 2].max() <= 0.8)


def plot(rows, chosen):
    """An SVG scatter of the predictions' means colour is lambda2, radius lambda1; the choice is ringed."""
    means = [np.mean([found[PREDICTED] for found in row["shots"].values()], axis=(0, 1))[[0, 2]] for row in rows]
    low, high = np.min(means, axis=0) - 0.02, np.max(means, axis=0) + 0.02
    points = []
    for row, mean in zip(rows, means, strict=True):
        x, y = np.array([60, 420]) + np.array([460, -380]) * (mean - low) / (high - low)
        ring = ' stroke="black" stroke-width="2"' if row is chosen else ""
        colour = COLOURS[LAMBDA2.index(row["lambda2"])]
        opacity = 1.0 if safe(row) else 0.35
        points.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{2 + 60 * row["lambda1"] ** 0.7:.1f}" fill="{colour}" '
            f'fill-opacity="{opacity}"{ring}/>'
        )
    legend = [
        f'<text x="420" y="{30 + 18 * i}" fill="{colour}">lambda2 = {value}</text>'
        for i, (value, colour) in enumerate(zip(LAMBDA2, COLOURS, strict=True))
    ]
    labels = (
        f'<text x="60" y="445">RMSE over input, {low[0]:.2f} .. {high[0]:.2f} (pale: a channel loses)</text>'
        f'<text x="5" y="15">change along the true flow over input, {low[1]:.2f} .. {high[1]:.2f}</text>'
    )
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="560" height="460" font-family="sans-serif" font-size="13">'
    return "\n".join([head, '<rect width="560" height="460" fill="white"/>', *points, *legend, labels, "</svg>"])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--held-out", type=Path, nargs="*", default=[])
    parser.add_argument("--work", type=Path, default=Path("temporal-sweep"))
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    started = time.perf_counter()
    rows = sweep(
        [Shot(path, options.work) for path in options.shots], itertools.product(LAMBDA1, LAMBDA2, DELTA, DIVISOR)
    )
    chosen = min(filter(safe, rows), key=cost, default=min(rows, key=cost))
    settings = [tuple(chosen[name] for name in NAMES)]
    default = EnergyParams()
    print("chosen", *settings, "safe" if safe(chosen) else "NOT safe", "\nheld out, chosen and default:")
    settings.append((default.lambda1, default.lambda2, default.delta, DIVISOR_USED))
    held = sweep([Shot(path, options.work) for path in options.held_out], settings) if options.held_out else []
    lines = [
        json.dumps(row | {"set": name}) for name, part in (("chosen on", rows), ("held out", held)) for row in part
    ]
    (options.out / "temporal-sweep.json").write_text("[\n" + ",\n".join(lines) + "\n]\n")
    (options.out / "temporal-sweep.svg").write_text(plot(rows, chosen) + "\n")
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
