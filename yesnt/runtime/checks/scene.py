"""What a run must know of the scene that the subject is put into, before anything is made."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from yesnt.blender_set.render import scene_facts
from yesnt.capture_stage.tools import Tools, find_tools
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.scene_input import SceneFacts
from yesnt.core.shot import Job
from yesnt.io.fact_cache import FactCache
from yesnt.io.jobfile import frame_path
from yesnt.io.records import digest_of

WORKING_SPACE = "Linear Rec.709"
"""Blender's name of the space in which a scene is rendered; before 5.0 there is no other."""


def resolve_scene(job: Job, camera: Camera, digests: Mapping[str, str], facts: FactCache) -> SceneFacts | None:
    """What Blender says of the job's scene; None without one. It is remembered by the scene's content and Blender.

    Raises:
        MissingPartError: there is no Blender.
        JobError: the scene, or the lens of the shot's camera, cannot be used.
    """
    scene = job.shot.scene
    if scene is None:
        return None
    _refuse_lens(job, camera)
    path, tools = frame_path(job.root, scene, 0), find_tools(Path())
    key = digest_of({"scene": digests[str(path)], "path": str(path), "blender": _identity(tools)})
    found = facts.fetch(key, lambda: _ask(path, tools))
    if found["working_space"] != WORKING_SPACE:
        raise JobError(
            f"The scene is rendered in {found['working_space']}", str(path), WORKING_SPACE,
            "choose it in Blender: Render > Color Management > Working Space, or File > Blend File Working Space",
        )  # fmt: skip
    return SceneFacts(tuple(found["files"]), found["version"], found["denoises"])


def _ask(path: Path, tools: Tools) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        found = scene_facts(path, tools, Path(folder))
    return {**found, "version": ".".join(map(str, found["version"]))}


def _identity(tools: Tools) -> list[Any]:
    """Program and time of its last change: an update of Blender is asked again."""
    program = os.path.realpath(tools.blender)
    package = Path(tools.blender).absolute().parent.parent / "lib"
    return [tools.blender, os.stat(program).st_mtime_ns, package.stat().st_mtime_ns if package.exists() else 0]


def _refuse_lens(job: Job, camera: Camera) -> None:
    """Blender's perspective camera has no distortion of OpenCV's models."""
    bent = [frame for frame in job.frames if camera.lens(frame).distortion.acts]
    if bent:
        raise JobError(
            "The scene cannot be rendered through a lens that distorts",
            f"frame {bent[0]}: distortion {asdict(camera.lens(bent[0]).distortion)['model']}",
            "a camera without distortion, for a job with `set: {blend: ...}`",
            "undistort plate and G-buffer and set the camera's model to none",
        )  # fmt: skip
