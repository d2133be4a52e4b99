"""A long shot of tiny pictures, made in seconds: every frame's files are hard links to one frame's."""

from __future__ import annotations

import json
import os
from pathlib import Path

import yaml

from tests.tiny_shot import write_tiny_shot
from yesnt.io.records import Record, file_state
from yesnt.runtime.session import Session

FIRST = 1001


def write_long_shot(folder: Path, frames: int, size: tuple[int, int] = (16, 12)) -> Path:
    """Writes a shot whose frames all show the same; returns its job file."""
    path = write_tiny_shot(folder, 1, size, proxy=None)
    for frame in range(FIRST + 1, FIRST + frames):
        for name in ("plate", "gbuffer", "material"):
            os.link(folder / f"{name}.{FIRST}.exr", folder / f"{name}.{frame}.exr")
    camera = json.loads((folder / "camera.json").read_text())
    camera["frames"] = {str(FIRST + i): camera["frames"][str(FIRST)] for i in range(frames)}
    (folder / "camera.json").write_text(json.dumps(camera))
    job = yaml.safe_load(path.read_text()) | {"frames": f"{FIRST}-{FIRST + frames - 1}"}
    path.write_text(yaml.safe_dump(job))
    return path


def pretend_done(path: Path) -> None:
    """Writes the records that a finished run leaves, and its delivered files as hard links to one; nothing runs."""
    session = Session(path)
    session.output.exr.mkdir(parents=True)
    picture = session.output.exr / "one"
    picture.write_bytes(b"picture")
    digest = "d" * 32
    for node in session.graph():
        if node.transient:
            continue
        folder = session.book.path(node.stage, node.frames[0]).parent
        folder.mkdir(parents=True, exist_ok=True)
        for frame in node.frames:
            files = {}
            if node.stage.label == "composite":
                delivered = session.output.exr_path(session.job.shot.name, frame)
                os.link(picture, delivered)
                files = {str(delivered.relative_to(session.output.root)): digest}
            states = {name: file_state(session.output.root / name) for name in files}
            key, fields = node.frame_key(frame), node.frame_fields(frame)
            seconds = {"task": 0.5, "kernel": 0.4}
            record = Record(node.stage.label, frame, key, fields, {}, files, seconds, {"peak_bytes": 1}, states)
            session.book.path(node.stage, frame).write_text(json.dumps(vars(record)))
    picture.unlink()
