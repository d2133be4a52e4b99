"""Fits the frames that follow a keyframe, each from the keyframe's field, and compares them with the keyframe.

python tests/benchmarks/gaussian_follow.py FOLDER STATE.npz [--frames 1002-1004] [--steps 800] [--rigid]

FOLDER is one subject of `yesnt stage multiview`; STATE.npz holds the fit of frame 1001 by gaussian_fit.py --state.
Columns as those of gaussian_fit.py; processor seconds and seconds hold the hull, the rigid motion and the fit, as a
task of `yesnt gof fit` does, without reading. "start" is the keyframe's field after the motion, before any step.
--rigid only moves the field as a rigid body: Gaussians outside the hull stay, and nothing is added.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from gaussian_data import load, measure

from yesnt.capture.hull import visual_hull
from yesnt.gaussians.fit import fit
from yesnt.gaussians.fit_state import FitState
from yesnt.gaussians.following import continued
from yesnt.gaussians.initial import extent, pixel_width
from yesnt.gaussians.rigid import moved, rigid_motion
from yesnt.gaussians.settings import FitSettings
from yesnt.io.jobfile import parse_frames


def follow(before, moment, rigid, settings):
    """The state that the fit of a following frame starts from."""
    hull = visual_hull(moment.silhouettes)
    points, normals = hull.points.astype(np.float64), hull.normals.astype(np.float64)
    if rigid:
        start = moved(before, *rigid_motion(before.positions.astype(np.float64), points))
    else:
        start = continued(before, points, normals, hull.spacing, moment.targets, settings)
    return FitState.of(start, extent(hull.points), pixel_width(hull.points, moment.targets))


def told(name, state, moment, took=(0.0, 0.0)):
    figures = " ".join(f"{key} {value:.3f}" for key, value in measure(state, moment).items())
    print(f"{name}: {took[0]:.1f} processor seconds, {took[1]:.1f} s; {figures}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("state", type=Path)
    parser.add_argument("--frames", default="1002-1004")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--rigid", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    key = FitState.from_arrays(np.load(options.state))
    told("keyframe 1001", key, load(options.folder, 1001))
    following = FitSettings().following()
    settings = replace(following, steps=options.steps) if options.steps else following
    for frame in parse_frames(options.frames, "--frames"):
        moment = load(options.folder, frame)
        processor, wall = time.process_time(), time.monotonic()
        state = follow(key.gaussians, moment, options.rigid, settings)
        told(f"{frame} start", state, moment)
        for _ in fit(state, moment.targets, [], settings, frame):
            pass
        told(
            f"{frame} after {state.step} steps",
            state,
            moment,
            (time.process_time() - processor, time.monotonic() - wall),
        )


if __name__ == "__main__":
    main()
