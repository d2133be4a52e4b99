"""Fits a Gaussian field to a moment of a `multiview` set of the stage; prints how well held-out cameras are met.

python tests/benchmarks/gaussian_fit.py FOLDER [--frame 1001] [--steps 5000] [--cameras N] [--noise 0.02]
    [--weights depth=5,normal=0.3] [--state FILE.npz] [--seconds S]

FOLDER is one subject of `yesnt stage multiview`. Columns: steps, processor seconds of this run, Gaussians, PSNR in sRGB
where the matte exceeds 0.99, median and mean error of normals in degrees, median absolute error and bias of depth in %
of the height, holes in %. With --state the fit is kept at every look and taken up again; --seconds ends a run.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from gaussian_data import begin, load, measure

from yesnt.gaussians.fit import fit
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.settings import FitSettings


def weights_of(text):
    return {name: float(value) for name, value in (part.split("=") for part in text.split(",") if part)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frame", type=int, default=1001)
    parser.add_argument("--steps", type=int, default=FitSettings().steps)
    parser.add_argument("--cameras", type=int)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--weights", default="")
    parser.add_argument("--state", type=Path)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    settings = FitSettings(steps=options.steps)
    settings = replace(settings, weights=replace(settings.weights, **weights_of(options.weights)))
    moment = load(options.folder, options.frame, options.cameras, options.noise)
    kept = options.state is not None and options.state.exists()
    state = FitState.from_arrays(np.load(options.state)) if kept else begin(moment, settings)
    started, processor = time.monotonic(), time.process_time()
    for look in fit(state, moment.targets, moment.held_out, settings, options.frame):
        if options.state:
            np.savez(options.state, **state.to_arrays())
        figures = " ".join(f"{name} {value:.3f}" for name, value in measure(state, moment).items())
        print(look.step, f"{time.process_time() - processor:.1f} s", figures, flush=True)
        if time.monotonic() - started > options.seconds:
            break


if __name__ == "__main__":
    main()
