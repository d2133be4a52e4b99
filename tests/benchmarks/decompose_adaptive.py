"""Sampling that stops and keyframes against 16 members on every frame: nfe and error after temporal fusion.

python tests/benchmarks/decompose_adaptive.py FOLDER [FOLDER ...] [--frames 12] [--weights FILE] [--steps 2]

Each folder is a shot with truth. Error is the root mean square against the true material inside the matte.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import yaml

from yesnt.decompose.settings import EnsembleSettings
from yesnt.io.pictures.image import read_image
from yesnt.measure.trade.harness import Harness
from yesnt.runtime.session import Session

WHOLE = EnsembleSettings(16, tolerance=0.0, keyframe_step=1)
CASES = {
    "K=16": WHOLE,
    "K=4": replace(WHOLE, samples=4),
    "K=2": replace(WHOLE, samples=2),
    "tolerance 0.02": replace(WHOLE, tolerance=0.02),
    "tolerance 0.05": replace(WHOLE, tolerance=0.05),
    "tolerance 0.05, every 2nd": replace(WHOLE, tolerance=0.05, keyframe_step=2),
    "tolerance 0.05, every 4th": replace(WHOLE, tolerance=0.05, keyframe_step=4),
    "K=2, every 2nd": replace(WHOLE, samples=2, keyframe_step=2),
    "K=2, every 4th": replace(WHOLE, samples=2, keyframe_step=4),
    "K=4, every 4th": replace(WHOLE, samples=4, keyframe_step=4),
}


def open_harness(folder: Path, home: Path, frames: int, weights: Path | None) -> Harness:
    """The shot with absolute paths and an output of its own: its folder is only read."""
    job = yaml.safe_load((folder / "shot.yaml").read_text())
    for part in ("plate", "gbuffer", "light", "capture_light", "proxy"):
        job[part]["path"] = str(folder / job[part]["path"])
    job |= {"camera": str(folder / job["camera"]), "output": str(home / "out")}
    job["decompose"] = {"backend": "embedded"} | ({"weights": str(weights.absolute())} if weights else {})
    (home / "shot.yaml").write_text(yaml.safe_dump(job))
    session = Session(home)
    return Harness(session, session.job.frames[:frames])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument("--weights", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    for folder in options.folders:
        with tempfile.TemporaryDirectory() as home:
            harness = open_harness(folder.absolute(), Path(home), options.frames, options.weights)
            truth = np.stack([true_material(folder, frame) for frame in harness.frames], axis=1)
            inside = np.stack([plate.matte > 0.99 for plate in harness.plates])
            print(f"{folder.name}, {len(harness.frames)} frames, {options.steps} steps")
            print(f"{'case':26s} nfe  fewer  roughness: drawn  fused   metallic: drawn  fused  rank of spread")
            whole = 0
            for name, settings in CASES.items():
                mean, std, spent = harness.observe(settings, {"steps": options.steps}, "dis-quality")
                fused, _ = harness.fuse(mean, std, "dis-quality", 1e-4)
                drawn, solved = (np.sqrt(((v - truth) ** 2)[:, inside].mean(1)) for v in (mean, fused))
                whole = whole or spent.evaluations
                ranks = rank_correlation(std[0][inside], np.abs(mean - truth)[0][inside])
                print(
                    f"{name:26s} {spent.evaluations / len(harness.frames):11.1f}  {whole / spent.evaluations:5.1f}"
                    f"  {drawn[0]:16.4f} {solved[0]:6.4f} {drawn[1]:16.4f} {solved[1]:6.4f}  {ranks:14.2f}",
                    flush=True,
                )


def true_material(folder: Path, frame: int) -> np.ndarray:
    image = read_image(folder / "truth" / f"material.{frame}.exr")
    return np.stack([image.channels["roughness.Y"], image.channels["metallic.Y"]])


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(a[::7], b[::7]).statistic)


if __name__ == "__main__":
    main()
