"""Which rule of validity serves the solve best: soft or cut, colour's scale, forward-backward consistency.

    python tests/benchmarks/temporal_links.py SHOT ... --held-out SHOT ... [--work FOLDER]

A SHOT holds plate.####.exr and truth/material.####.exr (the stage's sequences). For each rule: RMSE to the truth and
RMSE of the frame-to-frame difference after the solve (with robust confidence), over the input's, roughness and
metallic, for what the embedded model predicts (kept in --work, made again when weights change) and an ensemble's noise
of 0.05. The mean of all ratios over the shots before --held-out chooses; held-out shots are then measured with the
choice and with the defaults. A cut at one half of exp(-(d / scale)^2) is a threshold on d, so scales are thresholds.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from temporal_shots import ensemble, errors, load, predicted

from yesnt.decompose.confidence import confidence
from yesnt.temporal import EnergyParams, FlowSettings, flow_validity, robust_confidence, solve
from yesnt.temporal.flow import dense_flow, encode_grey

OFF = 1e6
CONSISTENCY = {"none": (OFF, OFF), "0.05, 2": (0.05, 2.0), "0.01, 0.5": (0.01, 0.5)}
COLOUR, CUT = (0.1, 0.05, 0.03), (0.0, 0.5)
NOISE = 0.05


class Shot:
    """Flow of one shot and its inputs."""

    def __init__(self, folder, work):
        self.name = folder.name
        self.plates, self.matte, self.truth = load(folder)
        self.inputs = {"predicted": predicted(folder, work), f"noise {NOISE}": ensemble(self.truth, NOISE, 1)}
        grey = [encode_grey(plate, matte) for plate, matte in zip(self.plates, self.matte, strict=True)]
        method, self.pairs = FlowSettings().method, range(len(grey) - 1)
        self.flow = np.stack([dense_flow(grey[t], grey[t + 1], method) for t in self.pairs])
        self.back = np.stack([dense_flow(grey[t + 1], grey[t], method) for t in self.pairs])

    def links(self, settings):
        pair = [(self.plates[t], self.plates[t + 1], self.matte[t], self.matte[t + 1]) for t in self.pairs]
        return np.stack([flow_validity(self.flow[t], self.back[t], *pair[t], settings) for t in self.pairs])

    def ratios(self, settings):
        """[input, channel, (RMSE, difference)] over the input's own."""
        links = self.links(settings)
        return np.array([self._ratio(mean, std, links) for mean, std in self.inputs.values()])

    def _ratio(self, mean, std, links):
        weight, _ = robust_confidence(mean, confidence(std), self.flow, links, self.matte)
        value = solve(mean, weight, self.flow, links, EnergyParams(), self.matte, tolerance=1e-3).value
        return errors(value, self.truth, self.matte) / errors(mean, self.truth, self.matte)


def rules():
    for (relative, absolute), colour, cut in (
        (pair, colour, cut) for pair in CONSISTENCY.values() for colour in COLOUR for cut in CUT
    ):
        yield FlowSettings(relative=relative, absolute=absolute, photometric=colour, cut=cut)


def measure(shots, settings):
    """Prints one rule's line; returns its mean ratio."""
    found = np.array([shot.ratios(settings) for shot in shots])
    consistency = next(k for k, v in CONSISTENCY.items() if v == (settings.relative, settings.absolute))
    cells = [
        f"{shot.name} {ratio.astype(np.float64).round(3).tolist()}" for shot, ratio in zip(shots, found, strict=True)
    ]
    how = "cut " if settings.cut else "soft"
    print(f"{consistency:>9s}  {settings.photometric:.2f}  {how} mean {found.mean():.4f}  ", *cells, flush=True)
    return found.mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shots", type=Path, nargs="+")
    parser.add_argument("--held-out", type=Path, nargs="*", default=[])
    parser.add_argument("--work", type=Path, default=Path("temporal-sweep"))
    options = parser.parse_args()
    started = time.perf_counter()
    print(
        "held-out shots choose nothing. consistency, colour; [predicted, noise][roughness, metallic][RMSE, difference]"
    )
    shots = [Shot(path, options.work) for path in options.shots]
    means = {settings: measure(shots, settings) for settings in rules()}
    chosen = min(means, key=means.get)
    print("chosen", chosen, "\nheld out, chosen, default, and the default cut at one half:")
    held = [Shot(path, options.work) for path in options.held_out]
    for settings in (chosen, FlowSettings(), replace(FlowSettings(), cut=0.5)) if held else ():
        measure(held, settings)
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
