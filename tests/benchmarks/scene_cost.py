"""What a scene of Blender costs: the embedded shot in it, standard quality, two workers; killed, resumed, compared.

    python -m tests.benchmarks.scene_cost FOLDER [SCENE] [kill SECONDS] [FRAMES]

SCENE is one of `tests/blender/target_scenes.py` (pillar). FRAMES (1001-1016) are rendered, all are solved. Prints wall
and processor seconds of the run and of all that it started. `kill`: the same job in a second folder is killed after so
many seconds, with Blender and workers, and run again; says whether both folders hold the same EXRs.
"""

import ctypes
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import yaml

from yesnt.capture_stage.tools import find_tools, run_script

SHOT = Path(__file__).parents[2] / "yesnt" / "data" / "shot"
SCENES = Path(__file__).parents[1] / "blender" / "target_scenes.py"
SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER: what a killed run leaves behind is waited for here, and counted


def main():
    ctypes.CDLL(None).prctl(SUBREAPER, 1, 0, 0, 0)
    folder, *rest = sys.argv[1:]
    folder, kill = Path(folder).resolve(), None
    if "kill" in rest:
        at = rest.index("kill")
        kill, rest = float(rest[at + 1]), rest[:at] + rest[at + 2 :]
    frames = next((word for word in rest if word[0].isdigit()), "1001-1016")
    scene = next((word for word in rest if not word[0].isdigit()), "pillar")
    folder.mkdir(parents=True, exist_ok=True)
    run_script(find_tools(Path()), SCENES, [str(folder / "scenes"), scene], 600.0)
    whole = job(folder / "whole", folder / "scenes" / f"{scene}.blend")
    print(f"{scene}, {frames}: {run(whole, frames)}", flush=True)
    if kill is not None:
        again = job(folder / "killed", folder / "scenes" / f"{scene}.blend")
        print(f"killed: {run(again, frames, kill)}", flush=True)
        print(f"resumed: {run(again, frames)}", flush=True)
        print("the same bytes" if digests(whole) == digests(again) else "OTHER BYTES", flush=True)


def job(folder, scene):
    """The embedded shot in a scene that lights it."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(SHOT, folder)
    shot = yaml.safe_load((folder / "shot.yaml").read_text())
    shot |= {"set": {"blend": str(scene)}, "light": "set", "quality": "standard"}
    for name in ("capture", "evidence"):
        shot.pop(name, None)
    (folder / "shot.yaml").write_text(yaml.safe_dump(shot))
    return folder


def run(folder, frames, kill=None):
    """Runs a job, or kills all of it after some seconds; wall and processor seconds."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "yesnt", "run", str(folder), "--workers", "2", "--frames", frames]
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
    try:
        process.wait(kill)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
    if process.wait() not in (0, -signal.SIGKILL):
        raise SystemExit(f"the run ended with status {process.returncode}")
    wall = time.perf_counter() - began
    while True:  # workers and Blender, if they outlive the driver
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            break
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return f"{wall:.0f} s, {after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime:.0f} processor seconds"


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.glob("out/exr/*.exr"))}


if __name__ == "__main__":
    main()
