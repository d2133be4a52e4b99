"""Resident memory of real solver tasks of a 4K shot: a band of a chunk with halo, an exchange and a joint sweep.

    python tests/benchmarks/temporal_memory.py FOLDER [--frames 26] [--size 3840x2160]

Writes a shot of one textured sphere into FOLDER (a frame is written once and linked, so the disk holds one), runs what
comes before the solver, and then solver tasks, each in a process of its own. Prints what `plan` predicts beside the
peak (VmHWM) of each process. The sphere fills 53 % of its densest rows.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.io.exr import write_exr
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node


def write_shot(folder, frames, size):
    """One frame under many numbers; the camera and the flow stand still."""
    path = write_tiny_shot(folder, 1, size)
    write_exr(folder / "flow.1001.exr", dict.fromkeys(("forward.u", "forward.v"), np.zeros(size[::-1], np.float16)))
    for name in ("plate", "gbuffer", "material", "flow"):
        for frame in range(1002, 1001 + frames):
            link(folder / f"{name}.1001.exr", folder / f"{name}.{frame}.exr")
    for frame in range(1002, 1001 + frames):
        link(folder / "proxy.1001.ply", folder / f"proxy.{frame}.ply")
    camera = json.loads((folder / "camera.json").read_text())
    camera["frames"] = {str(1001 + k): camera["frames"]["1001"] for k in range(frames)}
    (folder / "camera.json").write_text(json.dumps(camera))
    job = yaml.safe_load(path.read_text()) | {"frames": f"1001-{1000 + frames}"}
    job["flow"] = {"path": "flow.####.exr"}
    job["temporal"] = {"robust": False}  # weighing frames takes long
    path.write_text(yaml.safe_dump(job))
    return path


def link(source, target):
    if not target.exists():
        os.link(source, target)


def run_one(path, number):
    """Runs one solver node of the list and prints its peak; for a process of its own."""
    session = Session(path)
    node = solver_nodes(session)[number]
    receipt = run_node(session.job, node)
    peak = 1024 * int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1])
    print(
        f"{node.stage.label:18s} chunk {node.index}  {receipt['seconds']:6.1f} s  peak {peak / 1e9:.2f} GB", flush=True
    )


def solver_nodes(session):
    return [node for node in session.graph() if node.stage.name == "solve"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=26)
    parser.add_argument("--size", default="3840x2160")
    parser.add_argument("--node", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--most", type=int, default=1000, help="solver tasks to run")
    options = parser.parse_args()
    path = options.folder / "shot.yaml"
    if options.node is not None:
        run_one(path, options.node)
        return
    if not path.exists():
        write_shot(options.folder, options.frames, tuple(int(v) for v in options.size.split("x")))
    session = run_here(path, until="confidence")
    plan = session.chunks
    print(f"{len(plan.bands)} bands, joint sweeps of {plan.joint} pixels, predicted {plan.peak_bytes / 1e9:.2f} GB")
    for number in range(min(options.most, len(solver_nodes(session)))):
        subprocess.run([sys.executable, __file__, str(options.folder), "--node", str(number)], check=True)


if __name__ == "__main__":
    main()
