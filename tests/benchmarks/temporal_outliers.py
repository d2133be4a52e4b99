"""What corrupted frames cost the clean ones: RMSE on clean frames over that of the uncorrupted solve.

    python tests/benchmarks/temporal_outliers.py SHOT ... [--work FOLDER]

A SHOT holds plate.####.exr and truth/material.####.exr. Inputs are the embedded model's predictions (kept in --work)
and an ensemble's noise on the true materials; a tenth of the frames is replaced by an offset, the inverse, noise, or a
shifted picture of themselves. Columns, in per cent, roughness and metallic: left as they are (plain); weighed by
`robust_confidence` (robust); also with these frames bridged, as a job does (robust, bridged); their data taken out by
hand (told); and, as an oracle, the sequence without these frames and a flow measured from the frame before to the frame
after (left out).
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from temporal_shots import ensemble, load, predicted

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_and_validity, robust_confidence, solve, solve_bridged

KINDS = ("offset", "inverted", "noise", "shifted")
PARAMS = EnergyParams()


def corrupt(mean, kind, frames):
    rng, broken = np.random.default_rng(5), mean.copy()
    for t in frames:
        if kind == "offset":
            broken[:, t] += 0.3
        elif kind == "inverted":
            broken[:, t] = 1 - broken[:, t]
        elif kind == "noise":
            broken[:, t] = rng.random(broken[:, t].shape)
        else:
            broken[:, t] = np.roll(broken[:, t], (23, 31), axis=(1, 2))
    return broken


class Links:
    """Flow and validity from frame to frame of some of a shot's frames."""

    def __init__(self, plates, matte, frames):
        pairs = [
            flow_and_validity(plates[t], plates[u], matte[t], matte[u], FlowSettings()) for t, u in pairwise(frames)
        ]
        self.flow, self.validity = (np.stack(parts) for parts in zip(*pairs, strict=True))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--work", type=Path, default=Path("temporal-sweep"))
    options = parser.parse_args()
    for folder in options.shots:
        plates, matte, truth = load(folder)
        links = Links(plates, matte, range(len(plates)))
        flow, validity = links.flow, links.validity
        count = max(1, round(len(plates) / 10))
        frames = [(2 * k + 1) * len(plates) // (2 * count) for k in range(count)]
        clean = np.setdiff1d(np.arange(len(plates)), frames)
        short = Links(plates, matte, clean)

        def error(value):
            pairs = zip(value, truth[:, clean], strict=True)  # noqa: B023
            return np.array([np.sqrt(np.mean((v - t)[matte[clean]] ** 2)) for v, t in pairs])  # noqa: B023

        def whole(mean, weight, inconsistent=()):
            found = solve_bridged(mean, weight, flow, validity, inconsistent, PARAMS, matte).value  # noqa: B023
            return error(found[:, clean])  # noqa: B023

        given = {"predicted": predicted(folder, options.work)}
        given |= {f"noise {strength}": ensemble(truth, strength, 2) for strength in (0.05, 0.02)}
        for source, (mean, std) in given.items():
            weight = confidence(std)
            usual, _ = robust_confidence(mean, weight, flow, validity, matte)
            base = whole(mean, usual)
            told = usual.copy()
            told[:, frames] = 0
            without = solve(mean[:, clean], usual[:, clean], short.flow, short.validity, PARAMS, matte[clean]).value
            for kind in KINDS:
                broken = corrupt(mean, kind, frames)
                robust, report = robust_confidence(broken, weight, flow, validity, matte)
                found = {
                    "plain": whole(broken, weight),
                    "robust": whole(broken, robust),
                    "robust, bridged": whole(broken, robust, report.frames),
                    "told": whole(broken, told),
                    "left out": error(without),
                }
                cells = "  ".join(
                    f"{name} {(100 * (v / base - 1)).astype(float).round(1).tolist()}" for name, v in found.items()
                )
                named = "named" if list(report.frames) == frames else report.frames
                print(folder.name, source, kind, named, cells, flush=True)


if __name__ == "__main__":
    main()
