"""Makes a long shot out of the embedded one: frames there and back again, as links, so that flow stays smooth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from yesnt.io.embedded_shot import SHOT

FIRST = 1001


def write_long_shot(folder: Path, frames: int, **changes: Any) -> Path:
    """Writes links, a camera and a job file; returns the job file."""
    folder.mkdir(parents=True)
    job = yaml.safe_load((SHOT / "shot.yaml").read_text())
    camera = json.loads((SHOT / "camera.json").read_text())
    source = sorted(int(number) for number in camera["frames"])
    order = source + source[-2:0:-1]
    poses = {}
    for i in range(frames):
        here, there = FIRST + i, order[i % len(order)]
        poses[str(here)] = camera["frames"][str(there)]
        for name, suffix in (("plate", "exr"), ("gbuffer", "exr"), ("proxy", "ply")):
            (folder / f"{name}.{here:04d}.{suffix}").symlink_to(SHOT / f"{name}.{there:04d}.{suffix}")
    (folder / "env").symlink_to(SHOT / "env")
    (folder / "camera.json").write_text(json.dumps(camera | {"frames": poses}))
    path = folder / "shot.yaml"
    path.write_text(yaml.safe_dump(job | {"frames": f"{FIRST}-{FIRST + frames - 1}"} | changes))
    return path
