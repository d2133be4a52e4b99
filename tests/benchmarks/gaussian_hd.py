"""A fit from cameras of 1920 x 1080: seconds and memory of the task against what `plan` predicts.

python -m tests.benchmarks.gaussian_hd SUBJECT STATE.npz OUT [--size 1920x1080] [--steps 60] [--cameras 24]

SUBJECT is a subject of the stage's `multiview` set, STATE.npz its fit by gaussian_fit.py --state. The pictures are made
by our own rasteriser from that field, as the subject's cameras see it with a finer sensor, and kept in OUT; the job
there is then planned and fitted in this process. Prints predicted and measured seconds (of the task, by the clock and
of the processor) and peak memory. Steps have the half resolution's share of a whole fit.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import cv2
import numpy as np

from tests.tiny_shot import write_tiny_shot
from yesnt.core.camera import Camera
from yesnt.gaussians.fit_state import FitState
from yesnt.inspect.forecast import forecast
from yesnt.io.cameras import read_cameras
from yesnt.io.exr import write_exr
from yesnt.runtime.control.share import run_shared
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session
from yesnt.tasks.gaussians import view_planes


def finer(camera, pose, size):
    """The camera at rest with a sensor of `size` columns and rows, whose rows show what the given one's show."""
    scale = size[1] / camera.height
    cx = 0.5 * size[0] + scale * (camera.cx - 0.5 * camera.width)
    return Camera(*size, scale * camera.fx, scale * camera.fy, cx, scale * camera.cy, {0: camera.pose(pose)})


def write_job(options, size):
    """The job file; pictures that are there stay."""
    found = list(read_cameras(options.subject / "cameras.json").items())
    found = [found[i] for i in np.unique(np.linspace(0, len(found) - 1, options.cameras).round().astype(int))]
    field, cameras = FitState.from_arrays(np.load(options.state)).gaussians, {}
    section = {"cameras": "cameras.json", "images": "capture/{camera}/plate.####.exr"}
    knobs = {"steps": options.steps, "check": max(options.steps // 2, 1)}
    bare = {"plate": None, "gbuffer": None, "proxy": None, "evidence": {"use": False}, "capture": section}
    job = write_tiny_shot(options.out, 1, (24, 20), **bare, gaussians={"knobs": knobs})
    for name, one in found:
        camera = finer(one.camera, one.pose_of(1001), size)
        lens = {"width": size[0], "height": size[1], "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        cameras[name] = lens | {"world_from_camera": camera.pose(0).ravel().tolist()}
        path = options.out / f"capture/{name}/plate.1001.exr"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            planes = view_planes(field, camera, 0)
            write_exr(path, {channel: planes[channel].astype(np.float16) for channel in "RGBA"})
    (options.out / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    return job


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subject", type=Path)
    parser.add_argument("state", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--cameras", type=int, default=24)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    size = tuple(int(side) for side in options.size.split("x"))
    job = write_job(options, size)
    row = forecast(Session(job)).stages[0]
    print(f"plan: {row.stage} {row.seconds:.1f} s, {row.peak_bytes / 2**20:.0f} MiB", flush=True)
    sizes = Session(job).checks.fit_sizes()
    print(f"crops: {np.mean([crop for _, crop in sizes]):.0f} pixels of {sizes[0][0]}", flush=True)
    began = time.process_time()
    result = run_shared(Session(job), RunOptions(until="fit", force=()))
    assert not result.missing, result.missing
    record = Session(job).book.find("fit", 1001)
    print(f"fit: {record.seconds['task']:.1f} s, {time.process_time() - began:.1f} processor seconds; {record.facts}")
    print(f"peak of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10:.0f} MiB")


if __name__ == "__main__":
    main()
