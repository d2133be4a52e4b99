"""Files of a rendered shot other than its images: camera, environment maps, shot.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from yesnt.capture_stage.jobs import CAPTURE, SETS, RenderJob, render_jobs, shot_frames_of
from yesnt.capture_stage.maps import map_path
from yesnt.capture_stage.reference import fitted_folder
from yesnt.capture_stage.rigs import Rig
from yesnt.capture_stage.tools import Tools
from yesnt.io.durable import write_bytes, write_json

MEASURED = "measured.yaml"
"""Job file of a shot whose materials a capture measures; it lies beside the `shot.yaml` of the same shot without."""

MEASURED_OUTPUT = "out-measured"
"""Its output folder."""


def shot_folder(job: RenderJob, out_dir: Path) -> Path:
    """Folder of a job's shot: `out_dir/SET/SUBJECT`, and `out_dir/SET-small/SUBJECT` for the small ones.

    A job of a fit has the folder that `yesnt eval --fit-steps` made of the fit; `out_dir` is then the evaluation's.
    """
    if job.fit:
        return fitted_folder(Path(out_dir), job.subject)
    home = SETS[job.set_name].completes or job.set_name
    return Path(out_dir) / (f"{home}-small" if _is_small(job) else home) / job.subject


def write_static_files(job: RenderJob, folder: Path, tools: Tools) -> list[str]:
    """Camera, lights and shot.yaml, or those of a capture: the same bytes whichever job of the set writes them."""
    if job.cameras:
        return _write_rig(job, folder)
    if SETS[job.set_name].completes is not None:
        return []
    for light in job.lights:
        write_bytes(folder / "env" / f"{light}.exr", map_path(job.map_of(light), tools).read_bytes())
    poses = {str(f): {"world_from_camera": job.pose(f).ravel().tolist()} for f in shot_frames(job)}
    write_json(folder / "camera.json", _lens(job) | {"frames": poses})
    write_bytes(folder / "shot.yaml", shot_yaml(job).encode())
    return [*(f"env/{light}.exr" for light in job.lights), "camera.json", "shot.yaml"]


def _lens(job: RenderJob) -> dict[str, Any]:
    return {
        "width": job.width, "height": job.height, "fx": job.focal, "fy": job.focal,
        "cx": job.width / 2, "cy": job.height / 2,
    }  # fmt: skip


def _write_rig(job: RenderJob, folder: Path) -> list[str]:
    """Calibration of the capture and of cameras that are held out, and the job file that is measured by them."""
    rig = SETS[job.set_name].rig
    assert rig is not None
    files = {"cameras.json": rig.cameras, "heldout.json": rig.held_out_cameras}
    files = {name: cameras for name, cameras in files.items() if cameras}
    for name, cameras in files.items():
        poses = {one: {"world_from_camera": job.camera_pose(one).ravel().tolist()} for one in cameras}
        write_json(folder / name, {"cameras": {one: _lens(job) | pose for one, pose in poses.items()}})
    write_bytes(folder / MEASURED, measured_yaml(job, rig).encode())
    return [*files, MEASURED]


def picture_name(job: RenderJob, camera: str, what: str, frame: int) -> str:
    """Path of a picture of the rig below the shot's folder."""
    rig = SETS[job.set_name].rig
    assert rig is not None
    return f"{'capture' if camera in rig.cameras else 'heldout'}/{camera}/{what}.{frame}.exr"


def shot_frames(job: RenderJob) -> tuple[int, ...]:
    """All frames of the shot that a job belongs to (of a small set: of the job)."""
    stage_set = SETS[job.set_name]
    return job.frames if _is_small(job) else shot_frames_of(stage_set, job.subject)


def _is_small(job: RenderJob) -> bool:
    return job.height != SETS[job.set_name].height


def shot_yaml(job: RenderJob, light: str | None = None, more: str = "", output: str = "out") -> str:
    """The job file of the shot, lit by its first truth light (contract.md)."""
    frames = shot_frames(job)
    light = light or next((name for name in job.lights if name != CAPTURE), CAPTURE)
    return (
        "version: 1\n"
        f"name: {job.subject}\n"
        f"frames: {frames[0]}-{frames[-1]}\n"
        "plate:   {path: plate.####.exr, colorspace: lin_rec709}\n"
        "gbuffer: {path: gbuffer.####.exr, z: depth.Z, normal: N, normal_space: world}\n"
        "camera:  camera.json\n"
        "proxy:   {path: proxy.####.ply}\n"
        f"light:   {{path: env/{light}.exr, convention: blender, rotation: [0, 0, 0], exposure: 0}}\n"
        f"capture_light: {{path: env/{CAPTURE}.exr}}\n"
        f"{more}"
        "decompose: {backend: embedded, samples: 2}\n"
        "quality: standard\n"
        "seed: 0\n"
        f"output:  {output}\n"
    )


def measured_yaml(job: RenderJob, rig: Rig) -> str:
    """The job file of the same shot with a capture."""
    home = render_jobs(SETS[job.set_name].completes or job.set_name, _is_small(job))[0]
    light = next((name for name in home.lights if name != CAPTURE), CAPTURE)
    every = f"evidence: {{every: {rig.every}}}\n" if rig.every > 1 else ""
    capture = 'capture: {cameras: cameras.json, images: "capture/{camera}/plate.####.exr"}\n'
    return shot_yaml(job, light, capture + every, MEASURED_OUTPUT)
