"""Runs a render job: Blender as a subprocess, then the images of a shot in the form of contract.md."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.capture_stage import passes
from yesnt.capture_stage.jobs import CAPTURE, SETS, RenderJob
from yesnt.capture_stage.maps import map_path
from yesnt.capture_stage.reference import RECORDS, projected
from yesnt.capture_stage.shotfiles import picture_name, shot_folder, write_static_files
from yesnt.capture_stage.subjects import prepare
from yesnt.capture_stage.tools import Tools, run_blender
from yesnt.core.errors import CorruptError
from yesnt.io.durable import write_bytes, write_json
from yesnt.io.exr import write_exr

PROXY_TRIANGLES = 4500


@dataclass(frozen=True)
class Receipt:
    """Result of a render job.

    Attributes:
        key: of the job.
        folder: of its shot.
        files: path below the folder -> sha256.
        seconds: that the attempt which finished took.
        rendered: pictures that this call rendered; 0 where all were there.
        cpu_seconds: processor time of this process and of Blender in the attempt that finished.
    """

    key: str
    folder: str
    files: Mapping[str, str]
    seconds: float
    rendered: int
    cpu_seconds: float = 0.0


def find_receipt(job: RenderJob, out_dir: Path) -> Receipt | None:
    """The record of a finished job whose files are all there with their digests, else None."""
    folder = shot_folder(job, out_dir)
    try:
        data = json.loads(_record_path(job, folder).read_text())
        whole = all(_digest(folder / name) == digest for name, digest in data["files"].items())
    except (OSError, ValueError, KeyError):
        return None
    if not whole:
        return None
    return Receipt(job.key, str(folder), data["files"], data["seconds"], 0, data.get("cpu_seconds", 0.0))


def render(job: RenderJob, out_dir: Path, tools: Tools) -> Receipt:
    """Makes the files of a job; idempotent, resumable, and safe to kill at any time.

    Args:
        job: what to render.
        out_dir: root of all sets.
        tools: Blender, anny, cache.

    Returns:
        The record, which is also on disk: a second call returns at once.

    Raises:
        MissingPartError: Blender, anny or an asset cannot be had.
        YesntError: Blender failed.
    """
    done = find_receipt(job, out_dir)
    if done is not None:
        return done
    start, busy = time.perf_counter(), _cpu_seconds()
    folder = shot_folder(job, out_dir)
    raw = folder / RECORDS / f"raw-{job.key[:16]}"
    for path in (raw, folder / "env", folder / "truth"):
        path.mkdir(parents=True, exist_ok=True)
    missing = [item for item in _renders(job, raw, tools) if not _is_whole(Path(item["out"]))]
    if missing:
        run_blender(tools, _request(job, missing, raw, tools), raw)
    files = [name for frame in job.frames for name in _write_frame(job, frame, raw, folder)]
    files += write_static_files(job, folder, tools)
    digests = {name: _digest(folder / name) for name in sorted(files)}
    seconds, busy = time.perf_counter() - start, _cpu_seconds() - busy
    receipt = Receipt(job.key, str(folder), digests, seconds, len(missing), busy)
    record = {"key": job.key, "job": job.to_json(), "files": digests, "seconds": seconds, "cpu_seconds": busy}
    write_json(_record_path(job, folder), record)
    shutil.rmtree(raw)
    return receipt


def _cpu_seconds() -> float:
    """Processor time of this process and of its children that have ended."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _record_path(job: RenderJob, folder: Path) -> Path:
    return folder / RECORDS / f"{job.key[:32]}.json"


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _renders(job: RenderJob, raw: Path, tools: Tools) -> list[dict[str, Any]]:
    """The images that Blender renders, frame by frame, so that the scene stays loaded for all lights."""
    if job.cameras:
        return [item for frame in job.frames for item in _rig_renders(job, frame, raw, tools)]
    out: list[dict[str, Any]] = []
    for frame in job.frames:
        if CAPTURE in job.lights:
            out.append({"what": "geometry", "frame": frame, "out": str(raw / f"geometry.{frame}.exr")})
            out.append({"what": "proxy", "frame": frame, "out": str(raw / f"proxy.{frame}.ply")})
        out += [
            {"what": "light", "frame": frame, "env": _env(job, n, tools), "out": str(raw / f"{n}.{frame}.exr")}
            for n in job.lights
        ]
        out += [
            {"what": "light", "frame": frame, "env": _env(job, n, tools), "bounces": bounces,
             "out": str(raw / f"{_limited(n, bounces)}.{frame}.exr")}
            for n in job.lights if n != CAPTURE
            for bounces in job.bounces
        ]  # fmt: skip
    return out


def _rig_renders(job: RenderJob, frame: int, raw: Path, tools: Tools) -> list[dict[str, Any]]:
    """One frame of every camera; geometry only of cameras that are held out."""
    rig = SETS[job.set_name].rig
    assert rig is not None
    out: list[dict[str, Any]] = []
    if rig.mesh:
        out.append({"what": "mesh", "frame": frame, "out": str(raw / f"mesh.{frame}.ply")})
    for name in job.cameras:
        shot = {"frame": frame, "world_from_camera": job.camera_pose(name).tolist()}
        env = _env(job, CAPTURE, tools)
        out.append({"what": "light", **shot, "env": env, "out": str(raw / f"{name}.{frame}.exr")})
        if name in rig.held_out_cameras:
            out.append({"what": "geometry", **shot, "out": str(raw / f"{name}-geometry.{frame}.exr")})
    return out


def _env(job: RenderJob, light: str, tools: Tools) -> str:
    return str(map_path(job.map_of(light), tools))


def _limited(light: str, bounces: int) -> str:
    """Name of the picture under a light whose paths end after so many bounces."""
    return f"bounces{bounces}_{light}"


def _is_whole(path: Path) -> bool:
    """Whether a raw picture exists and decodes; otherwise it is rendered again."""
    if not path.exists():
        return False
    try:
        return path.suffix != ".exr" or bool(passes.read_passes(path))
    except CorruptError:
        return False


def _request(job: RenderJob, renders: list[dict[str, Any]], raw: Path, tools: Tools) -> dict[str, Any]:
    """The request of `inside_blender/main.py`; one frame more on either side, for the motion vectors."""
    frames = range(job.frames[0] - 1, job.frames[-1] + 2)
    stage_set = SETS[job.set_name]
    if stage_set.completes and not job.cameras:
        subject = projected(job, raw, raw.parent.parent)
    else:
        subject = prepare(job.subject, [job.seconds(f) for f in frames], tools, raw)
    return {
        "subject": {**subject, "start": stage_set.frames[0]},
        "width": job.width, "height": job.height, "fx": job.focal,
        "samples": job.samples, "threads": tools.threads, "proxy_triangles": PROXY_TRIANGLES,
        "truth": not job.cameras,
        "frames": [
            {"frame": f, "shape": i, "world_from_camera": job.pose(f).tolist()} for i, f in enumerate(frames)
        ],
        "renders": renders,
    }  # fmt: skip


def _write_frame(job: RenderJob, frame: int, raw: Path, folder: Path) -> list[str]:
    """Writes one frame's files; returns their names."""
    if job.cameras:
        return _write_rig_frame(job, frame, raw, folder)
    made: dict[str, dict[str, Any]] = {}
    kind = "proxy" if SETS[job.set_name].completes else "relit"
    for light in job.lights:
        lit = passes.read_passes(raw / f"{light}.{frame}.exr")
        if light != CAPTURE:
            made[f"truth/{kind}_{light}.{frame}.exr"] = passes.picture(lit)
            continue
        points = passes.read_passes(raw / f"geometry.{frame}.exr")
        made[f"plate.{frame}.exr"] = passes.picture(lit)
        made[f"gbuffer.{frame}.exr"] = passes.geometry(points, lit)
        made[f"truth/material.{frame}.exr"] = passes.materials(lit)
        if SETS[job.set_name].moving:
            made[f"truth/flow.{frame}.exr"] = passes.flow(points, lit)
    for name in (_limited(n, bounces) for n in job.lights if n != CAPTURE for bounces in job.bounces):
        made[f"truth/{name}.{frame}.exr"] = passes.picture(passes.read_passes(raw / f"{name}.{frame}.exr"))
    for name, channels in made.items():
        write_exr(folder / name, channels)
    if CAPTURE not in job.lights:
        return list(made)
    write_bytes(folder / f"proxy.{frame}.ply", (raw / f"proxy.{frame}.ply").read_bytes())
    return [*made, f"proxy.{frame}.ply"]


def _write_rig_frame(job: RenderJob, frame: int, raw: Path, folder: Path) -> list[str]:
    """Writes one frame of the capture; returns the names of its files."""
    made = []
    for name in job.cameras:
        lit, geometry = passes.read_passes(raw / f"{name}.{frame}.exr"), raw / f"{name}-geometry.{frame}.exr"
        pictures = {"plate": passes.picture(lit)}
        if geometry.exists():
            pictures["gbuffer"] = passes.geometry(passes.read_passes(geometry), lit)
        for what, channels in pictures.items():
            path = picture_name(job, name, what, frame)
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_exr(folder / path, channels)
            made.append(path)
    mesh = raw / f"mesh.{frame}.ply"
    if mesh.exists():
        write_bytes(folder / "truth" / mesh.name, mesh.read_bytes())
        made.append(f"truth/{mesh.name}")
    return made
