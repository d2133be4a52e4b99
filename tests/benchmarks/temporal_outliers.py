"""What corrupted frames cost the clean ones: RMSE on clean frames over that of the uncorrupted solve.

    python tests/benchmarks/temporal_outliers.py SHOT ... [--work FOLDER]

A SHOT holds plate.####.exr and truth/material.####.exr. Inputs are the embedded model's predictions (kept in --work)
and an ensemble's noise on the true materials; a tenth of the frames is replaced by an offset, the inverse, noise, or a
shifted picture of themselves. Columns, in per cent, roughness and metallic: left as they are (plain); weighed by
`robust_confidence` (robust); their data term taken out by hand (told); with links of doubled weight around what is
distrusted, as if the neighbours' warps were composed (bridged: robust, and told).
"""

import argparse
from pathlib import Path

import numpy as np
from temporal_shots import ensemble, load, predicted

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_and_validity, robust_confidence, solve

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


def bridged(validity, frames):
    """Links of doubled weight into and out of these frames: in series they are as stiff as one."""
    links = validity.copy()
    for t in frames:
        links[max(0, t - 1) : t + 1] = 2 * validity[max(0, t - 1) : t + 1]
    return links


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--work", type=Path, default=Path("temporal-sweep"))
    options = parser.parse_args()
    for folder in options.shots:
        plates, matte, truth = load(folder)
        pairs = [
            flow_and_validity(plates[t], plates[t + 1], matte[t], matte[t + 1], FlowSettings())
            for t in range(len(plates) - 1)
        ]
        flow, validity = (np.stack(parts) for parts in zip(*pairs, strict=True))
        count = max(1, round(len(plates) / 10))
        frames = [(2 * k + 1) * len(plates) // (2 * count) for k in range(count)]
        clean = np.setdiff1d(np.arange(len(plates)), frames)
        inside = matte[clean]

        def error(mean, weight, links):
            value = solve(mean, weight, flow, links, PARAMS, matte, tolerance=1e-4).value  # noqa: B023
            return np.array([np.sqrt(np.mean((v - t)[clean][inside] ** 2)) for v, t in zip(value, truth, strict=True)])  # noqa: B023

        given = {"predicted": predicted(folder, options.work)}
        given |= {f"noise {strength}": ensemble(truth, strength, 2) for strength in (0.05, 0.02)}
        for source, (mean, std) in given.items():
            weight = confidence(std)
            usual, _ = robust_confidence(mean, weight, flow, validity, matte)
            base = error(mean, usual, validity)
            for kind in KINDS:
                broken = corrupt(mean, kind, frames)
                robust, report = robust_confidence(broken, weight, flow, validity, matte)
                told = usual.copy()
                told[:, frames] = 0
                found = {
                    "plain": error(broken, weight, validity),
                    "robust": error(broken, robust, validity),
                    "told": error(broken, told, validity),
                    "robust, bridged": error(broken, robust, bridged(validity, report.frames)),
                    "told, bridged": error(broken, told, bridged(validity, frames)),
                }
                cells = "  ".join(f"{name} {(100 * (v / base - 1)).round(1).tolist()}" for name, v in found.items())
                named = "named" if list(report.frames) == frames else report.frames
                print(folder.name, source, kind, named, cells, flush=True)


if __name__ == "__main__":
    main()
