"""The subject in a set against Cycles, which renders the true subject in the same scene.

    python -m tests.benchmarks.set_truth FOLDER [--path blender|built-in] [--scenes NAME,...] [--subject vase]
        [--pictures DIR]

Renders the truth of the four ground scenes of `tests/blender/target_scenes.py` (kept in FOLDER), puts the shot through
the product with true materials, and prints PSNR in display values where the truth with and without the subject differ
by more than 0.01: of a set without any effect of the subject, and of the set with the true mesh as proxy and with a
decimated one. Then those of the subject's own pixels, relit in the light alone (built-in) and with the set's bounce.
With --pictures: subject over the set without an effect, in the set, Cycles.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from tests.blender.target_scenes_names import GROUNDS
from tests.in_process import run_here
from yesnt.blender_set.place import ActorPlace, camera_of
from yesnt.capture_stage import passes
from yesnt.capture_stage.cameras import look_at
from yesnt.capture_stage.subjects import prepare
from yesnt.capture_stage.tools import Tools, find_tools, run_script
from yesnt.core.camera import Camera
from yesnt.core.color import srgb_encode
from yesnt.io.exr import read_planes, write_exr
from yesnt.io.pictures.png import png_bytes

F32 = NDArray[np.float32]
HERE = Path(__file__).resolve().parent
FRAME, SIZE, SAMPLES, TRIANGLES = 1001, 192, 96, 4500
DIFFERENT = 0.01  # display values
CAMERA = Camera(SIZE, SIZE, 230.0, 230.0, SIZE / 2, SIZE / 2, {FRAME: look_at([0.9, -3.1, 1.5], [0.1, 0.05, 0.42])})


def main() -> None:
    """Prints one line a scene and proxy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--path", choices=("blender", "built-in"), default="blender")
    parser.add_argument("--scenes", default=",".join(GROUNDS))
    parser.add_argument("--subject", default="vase")
    parser.add_argument("--cache", type=Path, default=Path("stage-cache"))
    parser.add_argument("--proxies", default="true,decimated")
    parser.add_argument("--pictures", type=Path)
    chosen = parser.parse_args()
    tools = find_tools(chosen.cache)
    chosen.folder.mkdir(parents=True, exist_ok=True)
    print("scene            proxy       pixels  no effect      set  subject without bounce   with (dB)", flush=True)
    for name in chosen.scenes.split(","):
        work = (chosen.folder / f"{name}-{chosen.subject}").absolute()
        make_shot(work, name, chosen.subject, tools)
        for proxy in chosen.proxies.split(","):
            composite = product(work, name, proxy, chosen.path)
            alone = product(work, name, proxy, "alone") if chosen.path == "built-in" else None
            print(f"{name:16s} {proxy:10s} {line(work, composite, alone)}", flush=True)
            if chosen.pictures:
                file = chosen.pictures / f"set-{name}-{proxy}-{chosen.path}.png"
                file.write_bytes(png_bytes(picture(work, composite)))


def make_shot(work: Path, scene: str, subject: str, tools: Tools) -> None:
    """Truth and the shot of one scene, unless they are there."""
    if (work / "camera.json").exists():
        return
    work.mkdir(parents=True, exist_ok=True)
    run_script(tools, HERE.parent / "blender" / "target_scenes.py", [str(work.parent), scene], 600)
    request: dict[str, Any] = {
        "scene": str(work.parent / f"{scene}.blend"), "out": str(work), "threads": os.cpu_count(),
        "subject": prepare(subject, [0.0], tools, work), "samples": SAMPLES, "triangles": TRIANGLES,
        "camera": camera_of(CAMERA, FRAME, ActorPlace()),
    }  # fmt: skip
    (work / "request.json").write_text(json.dumps({**request, "subject": {**request["subject"], "start": FRAME}}))
    run_script(tools, HERE / "inside_blender" / "set_truth_scene.py", [str(work / "request.json")], 3600)
    lit, points = passes.read_passes(work / "plate.exr"), passes.read_passes(work / "points.exr")
    write_exr(work / f"plate.{FRAME}.exr", passes.picture(lit))
    write_exr(work / f"gbuffer.{FRAME}.exr", passes.geometry(points, lit))
    write_exr(work / f"material.{FRAME}.exr", passes.materials(lit))
    pose = CAMERA.pose(FRAME).ravel().tolist()
    document = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (work / "camera.json").write_text(json.dumps({**document, "frames": {str(FRAME): {"world_from_camera": pose}}}))


def product(work: Path, scene: str, proxy: str, path: str) -> dict[str, Any]:
    """Channels of the EXR that the product delivers; `path` alone: without a set."""
    light, color, roughness, metallic = GROUNDS[scene]
    built_in = {"ground": 0.0, "color": list(color), "roughness": roughness, "metallic": metallic}
    job = {
        "version": 1, "name": f"{proxy}-{path}", "frames": str(FRAME), "camera": "camera.json",
        "plate": {"path": "plate.####.exr"}, "gbuffer": {"path": "gbuffer.####.exr"}, "proxy": {"path": f"{proxy}.ply"},
        "light": "set" if path == "blender" else {"path": str(work.parent / "maps" / f"{light}.exr")},
        "decompose": {"path": "material.####.exr"}, "output": f"out-{proxy}-{path}",
        "set": {"blend": str(work.parent / f"{scene}.blend")} if path == "blender" else built_in,
    }  # fmt: skip
    if path == "alone":
        del job["set"]
    file = work / f"{proxy}-{path}.yaml"
    file.write_text(yaml.safe_dump(job))
    session = run_here(file, "composite")
    return read_planes(session.output.exr_path(session.job.shot.name, FRAME))


def line(work: Path, found: dict[str, Any], alone: dict[str, Any] | None) -> str:
    """Scores of one delivered frame, and of one without the set."""
    truth, without = (display(passes.read_passes(work / f"{name}.exr"), "Combined.") for name in ("truth", "without"))
    composite, clean = display(found), display(found, "env.")
    matte = found["relit.A"].astype(np.float32)
    judged = (np.abs(truth - without).max(axis=-1) > DIFFERENT) & (matte == 0)
    subject = matte > 0.99
    none = psnr(clean, truth, judged)
    without_bounce = psnr(display(alone), truth, subject) if alone else np.nan
    scores = psnr(composite, truth, judged), without_bounce, psnr(composite, truth, subject)
    return f"{int(judged.sum()):7d} {none:10.1f} {scores[0]:8.1f} {scores[1]:22.1f} {scores[2]:6.1f}"


def picture(work: Path, found: dict[str, Any]) -> F32:
    """Display values [H, 3 W, 3]: the subject over the set without its effect, in the set, and Cycles."""
    relit, env = (np.stack([found[f"{name}.{c}"].astype(np.float32) for c in "RGB"], -1) for name in ("relit", "env"))
    plain = relit + (1 - found["relit.A"].astype(np.float32)[..., None]) * env
    truth = display(passes.read_passes(work / "truth.exr"), "Combined.")
    return np.concatenate([srgb_encode(np.clip(plain, 0, 1)), display(found), truth], axis=1).astype(np.float32)


def display(planes: dict[str, Any], prefix: str = "") -> F32:
    """Display values [H, W, 3] of a layer."""
    linear = np.stack([planes[f"{prefix}{c}"].astype(np.float32) for c in "RGB"], axis=-1)
    return srgb_encode(np.clip(linear, 0, 1)).astype(np.float32)


def psnr(left: F32, right: F32, where: NDArray[np.bool_]) -> float:
    """Decibels over some pixels."""
    return float(-10 * np.log10(max(float(((left - right)[where] ** 2).mean()), 1e-12))) if where.any() else np.nan


if __name__ == "__main__":
    main()
