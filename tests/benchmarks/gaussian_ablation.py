"""What the losses of geometry are worth: fits of one moment with and without them, on clean, noisy and few pictures.

python tests/benchmarks/gaussian_ablation.py FOLDER OUT [--steps 1000] [--cases clean,noisy] [--losses default,none]

FOLDER is one subject of `yesnt stage multiview`. "noisy": 2 % noise on the pictures; "few": 8 of the cameras. Rows are
kept in OUT/rows.json, so that a run that was stopped goes on. Columns: PSNR of the held-out cameras where their matte
exceeds 0.99, median error of normals in degrees, median error of depth and its bias in % of the height, holes in %, and
by how much normals of neighbouring pixels differ beyond the truth's, in degrees (blocks). OUT/CASE-LOSSES.png shows the
first held-out camera: truth and fit, colour above normals.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from gaussian_data import begin, load, measure

from yesnt.gaussians.fit import fit
from yesnt.gaussians.rasterise import pinhole_of, rasterise
from yesnt.gaussians.render import rendered_view
from yesnt.gaussians.settings import FitSettings

LOSSES = {
    "default": {},
    "none": {"consistency": 0.0},
    "L_depth": {"depth": 5.0},
    "L_normal": {"normal": 0.3},
    "the paper's (both)": {"depth": 5.0, "normal": 0.3},
    "plain GOF": {"distortion": 100.0, "consistency": 0.05},
    "plain GOF + both": {"distortion": 100.0, "consistency": 0.05, "depth": 5.0, "normal": 0.3},
}
CASES = {"clean": (None, 0.0), "noisy": (None, 0.02), "few": (8, 0.0)}


def unit(normals):
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)


def roughness_of(normals, inside):
    """Median angle between the normals of neighbours in a row that both lie inside, degrees."""
    cosine = (normals[:, 1:] * normals[:, :-1]).sum(-1)[inside[:, 1:] & inside[:, :-1]]
    return float(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))


def seen_by(state, target):
    middle = state.values["positions"].mean(axis=0, dtype=np.float64)
    return rendered_view(rasterise(state.arrays, pinhole_of(target.view, middle, 0.05)), target.view)


def row_of(moment, settings):
    """Fits a moment; returns the figures and the first held-out camera's picture."""
    state = begin(moment, settings)
    for _ in fit(state, moment.targets, [], settings, moment.frame):
        pass
    figures = measure(state, moment)
    excess = []
    for target, (z, normal) in zip(moment.held_out, moment.truth, strict=True):
        inside = (target.matte > 0.99) & (z < 1e9)
        excess.append(roughness_of(seen_by(state, target).normal, inside) - roughness_of(unit(normal), inside))
    seen = seen_by(state, moment.held_out[0])
    picture = np.concatenate([seen.color, (0.5 + 0.5 * seen.normal) * seen.alpha[..., None]])
    return figures | {"blocks": float(np.mean(excess))}, picture


def truth_picture(moment):
    target, normal = moment.held_out[0], unit(moment.truth[0][1])
    return np.concatenate([target.color, (0.5 + 0.5 * normal) * target.matte[..., None]])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--losses", default=",".join(LOSSES))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / "rows.json"
    rows = json.loads(kept.read_text()) if kept.exists() else {}
    for case in options.cases.split(","):
        moment = load(options.folder, 1001, *CASES[case])
        for name in options.losses.split(","):
            key, picture = f"{case}: {name}", options.out / f"{case}-{name.replace(' ', '_')}.png"
            if key not in rows:
                base = FitSettings(steps=options.steps)
                settings = replace(base, weights=replace(base.weights, **LOSSES[name]))
                rows[key], seen = row_of(moment, settings)
                both = np.concatenate([truth_picture(moment), seen], axis=1)
                cv2.imwrite(str(picture), (255 * np.clip(both, 0, 1)[..., ::-1]).astype(np.uint8))
                kept.write_text(json.dumps(rows))
            r = rows[key]
            print(
                f"| {case} | {name} | {r['psnr']:.1f} | {r['normal']:.1f} | {r['depth']:.2f} | {r['bias']:+.2f} "
                f"| {r['holes']:.2f} | {r['blocks']:+.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
