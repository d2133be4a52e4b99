"""What each part of a fitted field costs the relit picture of a rendered shot, and where its normals are off.

    python -m tests.benchmarks.fitted_parts STAGE/objects/vase FIELD.ply --maps city,photo_studio

The shot is relit with true materials, with its given plate, G-buffer and proxy, and with one part of them from the
field's view, or all but the proxy; the matte counts, over black. Then normals of the field by distance from the edge of
the given matte, in pixels: angle to the true ones, and cosine to the ray of the field's and of the true normals.
`yesnt eval --fit-steps` prints the first table for fields that it fits itself, with the proxy.
"""

from __future__ import annotations

import argparse
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml
from scipy.ndimage import distance_transform_edt

from tests.in_process import run_here
from yesnt.io.jobfile import load_shot
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.measure.evaluation.fitted_rows import FITTED_ROWS
from yesnt.measure.evaluation.run import EvalOptions, _absolute
from yesnt.measure.evaluation.scene import ExchangedScene, Scene
from yesnt.measure.evaluation.subjects import find_subjects
from yesnt.metrics.score import SOLID, Truth, score_briefly
from yesnt.runtime.session import Session

PARTS = ("plate", "normals", "z")
BANDS = (-1, 0, 1, 2, 3, 5, 9, 999)


def open_jobs(subject, field, work):
    """The shot as it is given, and with plate and G-buffer from the field; both below a folder of their own."""
    document = _absolute(load_shot(subject.folder / "shot.yaml"), subject, EvalOptions())
    document["decompose"] = {"path": str(subject.folder / "truth" / "material.####.exr")}
    fitted = {k: v for k, v in document.items() if k not in ("plate", "matte", "gbuffer")}
    jobs = {"given": document, "fitted": fitted | {"gaussians": {"path": str(field.absolute())}}}
    for name, job in jobs.items():
        (work / name).mkdir()
        (work / name / "shot.yaml").write_text(yaml.safe_dump(job))
    run_here(work / "fitted", "view")
    return [Session(work / name).job for name in jobs]


def part_lines(subject, given, fitted, frame):
    row, true = FITTED_ROWS["fitted_true"], subject.read_material(frame, given.matte)
    scenes = {part: ExchangedScene(given.job, frame, given=given, other=fitted, part=part) for part in PARTS}
    for light, env in subject.maps:
        truth = Truth.of(*subject.read_relit(light, frame), given.matte)
        for label, scene in {"all as given": given, **scenes, "all but the proxy": fitted}.items():
            found = {m.name: m.value for m in score_briefly(scene.relit(row, true.planes, env), truth, scene.matte)}
            yield f"| {light} | {label} | {found['psnr']:.2f} | {found['psnr_whole']:.2f} | {found['ssim']:.3f} |"


def edge_lines(given, fitted, camera, frame):
    rays = camera.rays(frame)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    own, true = (unit(scene._inputs.gbuffer.normal) for scene in (fitted, given))
    away = distance_transform_edt(given.matte > SOLID)
    angle = np.degrees(np.arccos(np.clip((own * true).sum(-1), -1, 1)))
    cosines = [-(normals * rays).sum(-1) for normals in (own, true)]
    for low, high in pairwise(BANDS):
        band = (given.matte > 0) & (fitted.matte > 0) & (away > low) & (away <= high)
        if band.any():
            ends = np.percentile(angle[band], (50, 90))
            towards = " | ".join(f"{np.median(one[band]):.2f}" for one in cosines)
            label = "partly covered" if high == 0 else f"to {high} pixels" if high < BANDS[-1] else "farther"
            yield f"| {label} | {band.sum()} | {ends[0]:.1f} | {ends[1]:.1f} | {towards} |"


def unit(normals):
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("field", type=Path)
    parser.add_argument("--maps", default="city,photo_studio")
    options = parser.parse_args()
    (subject,) = find_subjects(options.folder, options.maps.split(","))
    with tempfile.TemporaryDirectory() as work:
        jobs = open_jobs(subject, options.field, Path(work))
        frame = jobs[0].frames[0]
        given, fitted = (Scene(job, frame) for job in jobs)
        print("| map | from the field | PSNR | whole | SSIM |\n|---|---|---|---|---|")
        for line in part_lines(subject, given, fitted, frame):
            print(line, flush=True)
        print("\n| distance from the edge | pixels | median | 90 % | cosine | true |\n|---|---|---|---|---|---|")
        for line in edge_lines(given, fitted, shot_camera(jobs[0]), frame):
            print(line)


if __name__ == "__main__":
    main()
