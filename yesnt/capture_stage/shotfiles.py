"""Files of a rendered shot other than its images: camera, environment maps, shot.yaml."""

from __future__ import annotations

from pathlib import Path

from yesnt.capture_stage.jobs import CAPTURE, SETS, RenderJob
from yesnt.capture_stage.maps import map_path
from yesnt.capture_stage.tools import Tools
from yesnt.io.durable import write_bytes, write_json


def shot_folder(job: RenderJob, out_dir: Path) -> Path:
    """Folder of a job's shot: `out_dir/SET/SUBJECT`, and `out_dir/SET-small/SUBJECT` for the small ones."""
    home = SETS[job.set_name].completes or job.set_name
    return Path(out_dir) / (f"{home}-small" if _is_small(job) else home) / job.subject


def write_static_files(job: RenderJob, folder: Path, tools: Tools) -> list[str]:
    """Camera, lights and shot.yaml: the same bytes whichever job of the shot writes them."""
    for light in job.lights:
        write_bytes(folder / "env" / f"{light}.exr", map_path(light, tools).read_bytes())
    frames = shot_frames(job)
    camera = {
        "width": job.width, "height": job.height, "fx": job.focal, "fy": job.focal,
        "cx": job.width / 2, "cy": job.height / 2,
        "frames": {str(f): {"world_from_camera": job.pose(f).ravel().tolist()} for f in frames},
    }  # fmt: skip
    write_json(folder / "camera.json", camera)
    write_bytes(folder / "shot.yaml", shot_yaml(job).encode())
    return [*(f"env/{light}.exr" for light in job.lights), "camera.json", "shot.yaml"]


def shot_frames(job: RenderJob) -> range:
    """All frames of the shot that a job belongs to (of a small set: of the job)."""
    first, last = SETS[job.set_name].frames
    return range(job.frames[0], job.frames[-1] + 1) if _is_small(job) else range(first, last + 1)


def _is_small(job: RenderJob) -> bool:
    return job.height != SETS[job.set_name].height


def shot_yaml(job: RenderJob) -> str:
    """The job file of the shot, lit by its first truth light (contract.md)."""
    frames = shot_frames(job)
    light = next((name for name in job.lights if name != CAPTURE), CAPTURE)
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
        "decompose: {backend: embedded, samples: 4}\n"
        "quality: standard\n"
        "seed: 0\n"
        "output:  out\n"
    )
