"""Validity's thresholds by precision and recall against true occlusion, and what the solve makes of them.

    python tests/benchmarks/temporal_validity.py SHOT ... [--solve]

A SHOT holds plate.####.exr, gbuffer.####.exr (depth.Z), truth/material.####.exr and truth/flow.####.exr. A link is bad
where the point is hidden in the next frame (by something 4 cm nearer, or it has no matte there), or where the flow is
off by a pixel. Counted over all shots: what each rule rejects (validity below one half), its recall and precision of
the hidden and of all bad links, and F1 of the latter. With --solve also RMSE to the true materials and RMSE of the
frame-to-frame difference after a solve of noisy ones, over the input's, with validity as it is and cut at one half.
"""

import argparse
from pathlib import Path

import numpy as np
from temporal_flow import Shot
from temporal_shots import ensemble, errors

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, solve

OFF = 1e6
CONSISTENCY = {"none": (OFF, OFF), "0.01, 0.5": (0.01, 0.5), "0.05, 2": (0.05, 2.0), "0.01, 0.1": (0.01, 0.1)}
COLOUR = (np.inf, 0.2, 0.1, 0.05, 0.03)
SOLVED = (np.inf, 0.1, 0.05)
NOISE = 0.05


class Judged:
    """Flow of one shot and where it is bad."""

    def __init__(self, folder):
        self.shot = Shot(folder)
        self.both, _ = self.shot.flows(FlowSettings().method)
        self.flow = np.stack([forward for forward, _ in self.both])
        self.inside, self.hidden = self.shot.matte[:-1], np.stack(self.shot.hidden)
        self.bad = self.hidden | (self.inside & (np.linalg.norm(self.flow - self.shot.flow, axis=-1) > 1))

    def counts(self, validity):
        """[inside, rejected, hidden, hidden and rejected, bad, bad and rejected]."""
        rejected = self.inside & (validity < 0.5)
        masks = (self.inside, rejected, self.hidden, self.hidden & rejected, self.bad, self.bad & rejected)
        return np.array([mask.sum() for mask in masks], np.float64)

    def solved(self, validity):
        """RMSE and difference over the input's, mean of the channels."""
        shot = self.shot
        mean, std = ensemble(shot.truth, NOISE, 3)
        value = solve(mean, confidence(std), self.flow, validity, EnergyParams(), shot.matte, tolerance=1e-3).value
        return np.mean(errors(value, shot.truth, shot.matte) / errors(mean, shot.truth, shot.matte), axis=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--solve", action="store_true")
    options = parser.parse_args()
    shots = [Judged(path) for path in options.shots]
    print("forward-backward  colour  rejects  hidden: recall precision  bad: recall precision    F1")
    for name, (relative, absolute) in CONSISTENCY.items():
        for colour in COLOUR:
            if relative == OFF and np.isinf(colour):
                continue
            settings = FlowSettings(relative=relative, absolute=absolute, photometric=colour)
            found = [judged.shot.validity(judged.both, settings) for judged in shots]
            all_, rejected, hidden, both, bad, all_bad = sum(j.counts(v) for j, v in zip(shots, found, strict=True))
            recall, precision = all_bad / bad, all_bad / max(rejected, 1)
            seen = both / hidden, both / max(rejected, 1)
            cells = (
                f"{name:>16s} {colour:7.2f} {rejected / all_:8.3f} {seen[0]:15.2f} {seen[1]:9.2f} "
                f"{recall:12.2f} {precision:9.2f} {2 * recall * precision / (recall + precision):8.3f}"
            )
            if options.solve and colour in SOLVED:
                soft = np.mean([j.solved(v) for j, v in zip(shots, found, strict=True)], axis=0)
                hard = np.mean([j.solved((v >= 0.5).astype(np.float32)) for j, v in zip(shots, found, strict=True)], 0)
                cells += f"   soft x{soft[0]:.3f} x{soft[1]:.3f}   cut x{hard[0]:.3f} x{hard[1]:.3f}"
            print(cells, flush=True)


if __name__ == "__main__":
    main()
