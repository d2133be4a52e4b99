"""The capture light, estimated from the plate or from the capture's cameras; and the files that it is estimated from.

Every worker estimates it for itself. The files are read from the job alone, so that a key that names them is the same
as what a worker reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from yesnt.capture.files import camera_files
from yesnt.capture.pictures import read_view
from yesnt.capture.plan import light_probes, plan_capture
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.cameras import calibration_roles, cameras_of
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.shot_raster import shot_camera

if TYPE_CHECKING:
    from yesnt.relight import EnvMap


def estimated_map(job: Job) -> EnvMap:
    """The capture light of mean radiance 1: from the pictures of all cameras if they measure, else from the plate.

    Raises:
        JobError: a file cannot be read.
    """
    probes = _probes(job)
    return _from_cameras(job, probes) if probes else _from_plate(job)


def estimate_files(job: Job) -> dict[str, Path]:
    """Role -> file, for every file that the light is estimated from."""
    shot, root, probes = job.shot, job.root, _probes(job)
    found = {"camera": frame_path(root, shot.camera, 0)}
    patterns = {"plate": shot.plate.path, "matte": shot.matte.path if shot.matte else None}
    patterns |= {"proxy": shot.proxy.path if shot.proxy else None} if probes else {"gbuffer": shot.gbuffer.path}
    for frame in probes or job.probe_frames:
        for role, pattern in patterns.items():
            if pattern is not None:
                found[f"probe {role} {frame}"] = frame_path(root, pattern, frame)
    if probes and shot.captured is not None:
        found |= {f"probe {role}": path for role, path in calibration_roles(root, shot.captured).items()}
        for frame, names in probes.items():
            for name in names:
                files = camera_files(root, shot.captured, name, frame)
                found |= {f"probe {role} {name} {frame}": path for role, path in files.items()}
    return found


def _probes(job: Job) -> Mapping[int, tuple[str, ...]]:
    """Frames and cameras of the capture that tell of the light; none without a capture that measures."""
    return light_probes(plan_capture(job, shot_camera(job)).views) if job.shot.captured is not None else {}


def _from_plate(job: Job) -> EnvMap:
    """From the shading of the plate in the probe frames."""
    from yesnt.relight import Surface, estimate_capture

    camera = shot_camera(job)
    plates, surfaces = [], []
    for frame in job.probe_frames:
        plate = shot_inputs.read_plate(job, frame, working=True)
        seen = shot_inputs.read_surface(job, frame, camera)
        unknown = np.zeros_like(seen.z)  # an estimate asks for no material
        plates.append(plate.color)
        surfaces.append(Surface(seen.normal, seen.z, plate.matte, unknown, unknown, camera, frame))
    return estimate_capture(plates, surfaces)


def _from_cameras(job: Job, probes: Mapping[int, tuple[str, ...]]) -> EnvMap:
    """From the shading of the proxy in all cameras' pictures and the plate."""
    from yesnt.decompose.evidence.capture_light import estimate_light
    from yesnt.decompose.evidence.observe import prepare_view
    from yesnt.decompose.evidence.records import View
    from yesnt.decompose.evidence.settings import EvidenceSettings
    from yesnt.relight import ProxyScene
    from yesnt.tasks.relight_inputs import proxy_scene, read_proxy

    camera, settings, frames = shot_camera(job), EvidenceSettings(), []
    assert job.shot.captured is not None
    calibrated = cameras_of(job.root, job.shot.captured)
    for frame, names in probes.items():
        proxy = proxy_scene(read_proxy(job, frame), ProxyScene)
        assert proxy is not None, "the job file's check"
        plate = shot_inputs.read_plate(job, frame, working=True)
        views = [View("plate", camera, frame, plate.color, plate.matte)]
        views += [read_view(job, name, calibrated[name], frame) for name in names]
        frames.append(([prepare_view(view, proxy, settings) for view in views], proxy))
    return estimate_light(frames, settings)
