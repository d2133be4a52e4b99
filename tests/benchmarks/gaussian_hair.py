"""Mattes at hair: coverage of a fitted field against the true one, on cameras that the fit does not see.

python tests/benchmarks/gaussian_hair.py FOLDER [--steps 5000] [--cameras N] [--state FILE.npz] [--seconds S]
    [--picture FILE.png]

FOLDER is STAGE/hair/bust+hair of `yesnt stage hair hair_capture`. Each line is one matte of the held-out cameras; its
columns are mean absolute errors of coverage, in the band within 3 pixels of any edge, and at wisps: pixels of the band
that are partly covered and farther than 1.5 pixels from all that are solid. The fit sees true mattes, then mattes that
are 0 or 1 as keying gives them; the lines between are the true mattes themselves made 0 or 1, and blurred. With
--state the fits are kept at every look and taken up again; --seconds ends a run.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from gaussian_data import begin, load

from yesnt.gaussians.fit import fit
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.rasterise import pinhole_of, rasterise
from yesnt.gaussians.settings import FitSettings

BAND, NEAR_SOLID = 3, 1.5
"""Pixels: half the width of the band around edges, and the distance to solid pixels at which a wisp begins."""


def band_of(matte):
    partly = (matte > 0.02) & (matte < 0.98)
    solid = (matte > 0.5).astype(np.uint8)
    edge = solid != cv2.erode(solid, np.ones((3, 3), np.uint8))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BAND + 1, 2 * BAND + 1))
    return cv2.dilate((partly | edge).astype(np.uint8), kernel) > 0


def wisps_of(matte):
    away = cv2.distanceTransform((matte < 0.98).astype(np.uint8), cv2.DIST_L2, 5)
    return (matte > 0.02) & (matte < 0.98) & (away > NEAR_SOLID)


def errors(mattes, truths):
    """Mean absolute error in the band and at wisps, over all pictures."""
    found = []
    for where in (band_of, wisps_of):
        apart = [np.abs(one - true)[where(true)] for one, true in zip(mattes, truths, strict=True)]
        found.append(float(np.concatenate(apart).mean()))
    return found


def keyed(moment):
    """The same moment with mattes of 0 and 1."""
    targets = [replace(target, matte=(target.matte > 0.5).astype(np.float32)) for target in moment.targets]
    targets = [replace(target, pixels=float(target.matte.sum())) for target in targets]
    silhouettes = [replace(one, matte=(one.matte > 0.5).astype(np.float32)) for one in moment.silhouettes]
    return replace(moment, targets=targets, silhouettes=silhouettes)


def fitted_mattes(moment, settings, path, until):
    """Coverage of the held-out cameras by a fit."""
    state = FitState.from_arrays(np.load(path)) if path is not None and path.exists() else begin(moment, settings)
    for look in () if state.step >= settings.steps else fit(state, moment.targets, [], settings, moment.frame):
        if path is not None:
            np.savez(path, **state.to_arrays())
        if time.monotonic() > until and not look.done:
            print(f"stopped at step {look.step}: run it again", flush=True)
            raise SystemExit(75)
    middle = state.values["positions"].mean(axis=0, dtype=np.float64)
    views = [pinhole_of(target.view, middle, settings.near) for target in moment.held_out]
    return [np.clip(rasterise(state.arrays, view).images[6], 0, 1) for view in views]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=FitSettings().steps)
    parser.add_argument("--cameras", type=int)
    parser.add_argument("--state", type=Path)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    until, settings = time.monotonic() + options.seconds, FitSettings(steps=options.steps)
    moment = load(options.folder, cameras=options.cameras)
    truths = [target.matte for target in moment.held_out]
    hard = [(true > 0.5).astype(np.float32) for true in truths]
    found = {
        "true, made 0 or 1": hard,
        "the same, blurred by 1 pixel": [cv2.GaussianBlur(one, (0, 0), 1) for one in hard],
    }
    for name, seen in (("fitted to true mattes", moment), ("fitted to mattes of 0 and 1", keyed(moment))):
        path = None if options.state is None else options.state.with_suffix(f".{len(found)}.npz")
        found[name] = fitted_mattes(seen, settings, path, until)
    for name, mattes in found.items():
        band, wisps = errors(mattes, truths)
        print(f"{name:30} band {band:.4f} wisps {wisps:.4f}", flush=True)
    if options.picture is not None:
        tiles = [np.concatenate([truths[i], *(mattes[i] for mattes in found.values())], axis=1) for i in (0, 2)]
        width = min(tile.shape[1] for tile in tiles)
        picture = np.concatenate([cv2.resize(t, (width, t.shape[0] * width // t.shape[1])) for t in tiles])
        cv2.imwrite(str(options.picture), np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8))


if __name__ == "__main__":
    main()
