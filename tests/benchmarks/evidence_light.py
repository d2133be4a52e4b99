"""The capture light estimated from all cameras against the true map, and what it costs the materials.

    python tests/benchmarks/evidence_light.py SHOT ...

SHOT is a job file with a capture, a capture map and `truth/` beside it (`yesnt stage objects objects_capture` makes
SUBJECT/measured.yaml). "map" is the root mean square difference from the true map over all directions, both of mean 1;
what bands 0 to 2 cannot hold is in it. Materials are measured by eight cameras in the first frame. The base colour is
that of the plate, its capture light divided out with these materials, and that with what all views add.
"""

import sys
from pathlib import Path

import numpy as np
import torch

from tests.benchmarks.evidence_over_time import figures
from yesnt.capture.pictures import read_view
from yesnt.core.shot import CaptureInput
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.evidence.frame import EvidenceInputs, measure_frame
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.io.cameras import cameras_of
from yesnt.measure.evaluation.subjects import Subject
from yesnt.measure.trade.harness import Harness, true_materials
from yesnt.measure.trade.variants import variants
from yesnt.planning import settings as of
from yesnt.relight import ProxyScene, uniform_light
from yesnt.relight.frame import base_color, prepare_capture
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import gather_pixels
from yesnt.runtime.session import Session
from yesnt.tasks.estimated_light import estimated_map
from yesnt.tasks.light import frame_map
from yesnt.tasks.relight_inputs import proxy_scene, read_proxy

COUNT = 2000
"""Directions in which maps are compared."""


def directions():
    """Directions [COUNT, 3], evenly over the sphere."""
    number = np.arange(COUNT) + 0.5
    z, turn = 1 - 2 * number / COUNT, np.pi * (1 + 5**0.5) * number
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def apart(one, other):
    """Root mean square difference of two maps of mean 1."""
    found = [env.lookup(directions().astype(np.float32)) for env in (one, other)]
    return float(np.sqrt(np.mean(np.square(found[0] / found[0].mean(0) - found[1] / found[1].mean(0)))))


def main(shots):
    torch.set_num_threads(1)
    print(
        "| shot | capture light | map | roughness RMSE | metallic RMSE | metallic AUC | base, plate | base, all views |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for path in shots:
        measure(Session(path))


def measure(session):
    job, frame = session.job, session.job.frames[0]
    harness, base = Harness(session, (frame,)), variants((1,))[0]
    plate = harness.plates[0]
    model = estimate_frame(plate.color, plate.matte, harness._backend(base.knobs), base.ensemble, 0, frame, None)
    truth, inside = true_materials(harness, (0,))[:, 0], plate.matte > 0.99
    cameras, names = cameras_of(job.root, job.shot.captured), session.resolved.capture.views[frame][:8]
    views = [read_view(job, name, cameras[name], frame) for name in names]
    bare, proxy = harness.bare(0), proxy_scene(read_proxy(job, frame), ProxyScene)
    shot = job.shot.model_copy(update={"capture_light": CaptureInput(estimate=True)})
    true = frame_map(job, job.shot.capture_light, frame)
    estimated = estimated_map(job.model_copy(update={"shot": shot}))
    settings = of.relight_settings(job.shot)
    name = Path(job.root).name
    base = Subject(Path(job.root), name, ()).read_material(frame, plate.matte).base_color
    print(f"| {name} | (the model alone) | | {figures(model.mean, truth, inside)} | | |", flush=True)
    for label, env in (("true map", true), ("estimated", estimated), ("taken for uniform", uniform_light())):
        light = prepare_capture(env, settings)
        given = EvidenceInputs(bare.plate.color, bare.surface(model.mean), model.std, views, proxy, light)
        found = measure_frame(given, settings, EvidenceSettings())
        alone = plate_colour(bare, found.mean, proxy, light, settings)
        colours = (alone, alone + found.base_views[..., 3:] * (found.base_views[..., :3] - alone))
        errors = " | ".join(f"{np.sqrt(np.square(one - base)[inside].mean()):.4f}" for one in colours)
        text = figures(found.mean, truth, inside)
        print(f"| {name} | {label} | {apart(env, true):.3f} | {text} | {errors} |", flush=True)


def plate_colour(bare, materials, proxy, light, settings):
    """Base colour [H, W, 3] with the capture light divided out of the plate."""
    surface = bare.surface(materials)
    pixels = gather_pixels(surface)
    occluders = find_occluders(surface, pixels, proxy, settings)
    return pixels.image(
        base_color(bare.plate.color.reshape(-1, 3)[pixels.index], pixels, occluders, light, settings)[0]
    )


if __name__ == "__main__":
    main(sys.argv[1:])
