"""Pictures of docs/set.md: a frame of the shot that ships, composited without a set and in one.

    python -m tests.benchmarks.set_pictures FOLDER docs/images [--frame 1005] [--scenes night,piece]

Keeps the shot and its results in FOLDER; takes the true materials, so that only the set differs from picture to
picture. Writes set-NAME.png: on the left the subject over the light's map, on the right in the set.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml

from tests.in_process import run_here
from yesnt.core.color import srgb_encode
from yesnt.io.embedded_shot import SHOT
from yesnt.io.exr import read_planes
from yesnt.io.pictures.png import png_bytes

SKY, NIGHT = {"path": "env/sky.exr"}, {"path": "env/studio.exr", "exposure": -2.5}
SCENES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "night": (NIGHT, {"ground": "auto", "color": [0.2, 0.2, 0.22], "roughness": 0.3}),
    "piece": (SKY, {"mesh": "piece.ply", "color": [0.55, 0.42, 0.3]}),
}
"""Light and set by name."""


def main() -> None:
    """Writes the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frame", default="1005")
    parser.add_argument("--scenes", default=",".join(SCENES))
    chosen = parser.parse_args()
    if not chosen.folder.exists():
        shutil.copytree(SHOT, chosen.folder)
    _write_piece(chosen.folder / "piece.ply", chosen.frame)
    for name in chosen.scenes.split(","):
        light, given = SCENES[name]
        panels = [_composite(chosen.folder, chosen.frame, f"{name}-{i}", light, s) for i, s in enumerate((None, given))]
        (chosen.out / f"set-{name}.png").write_bytes(png_bytes(np.concatenate(panels, axis=1)))


def _composite(folder: Path, frame: str, name: str, light: dict[str, Any], given: dict[str, Any] | None) -> Any:
    """Display values [H, W, 3] of the delivered frame."""
    job = yaml.safe_load((SHOT / "shot.yaml").read_text())
    job |= {"light": job["light"] | light, "decompose": {"path": "truth/material.####.exr"}, "output": f"out-{name}"}
    job |= {"set": given} if given else {}
    without = {"capture", "evidence"} | ({"set"} if given is None else set())
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump({key: value for key, value in job.items() if key not in without}))
    session = run_here(file, "composite", frame)
    planes = read_planes(session.output.exr_path(job["name"], int(frame)))
    linear = np.stack([planes[c].astype(np.float32) for c in "RGB"], axis=-1)
    return srgb_encode(np.clip(linear, 0, 1)).astype(np.float32)


def _write_piece(path: Path, frame: str) -> None:
    """A floor under the feet, a crate in front of the subject and a wall behind it."""
    feet = trimesh.load_mesh(SHOT / f"proxy.{frame}.ply").bounds[0][2]
    sizes = (8, 8, 0.1), (0.42, 0.3, 0.5), (5, 0.1, 1.2)
    places = (0, 0, -0.05), (0.2, -0.72, 0.17), (0, 1.6, 0.5)
    boxes = [trimesh.creation.box(size) for size in sizes]
    for box, place in zip(boxes, places, strict=True):
        box.apply_translation(np.add(place, (0, 0, feet)))
    trimesh.util.concatenate(boxes).export(path)


if __name__ == "__main__":
    main()
