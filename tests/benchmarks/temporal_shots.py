"""Shots with true materials for the temporal benchmarks: plates, truth, a model's prediction or an ensemble's noise."""

import cv2
import numpy as np
import OpenEXR
import yaml

from yesnt.io.store import FrameStore
from yesnt.planning.builders.decompose import full_frame_nodes
from yesnt.planning.graph import Graph
from yesnt.runtime.driver.driver import is_done
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node

STRENGTHS, MEMBERS = (0.02, 0.05, 0.1), 4
PATHS = ("plate", "gbuffer", "light", "capture_light", "background", "proxy")


def read(path):
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(channel.pixels, np.float32) for name, channel in channels.items()}


def load(folder):
    """Straight plate [T, H, W, 3], matte [T, H, W], true (roughness, metallic) [2, T, H, W]."""
    plates, mattes, truths = [], [], []
    for path in sorted(folder.glob("plate.*.exr")):
        plate = read(path)
        opacity = np.maximum(plate["A"], 1e-3)
        material = read(folder / "truth" / path.name.replace("plate", "material"))
        plates.append(np.stack([plate[c] for c in "RGB"], -1) / opacity[..., None])
        mattes.append(plate["A"] > 0.5)
        truths.append(np.stack([material[name] / opacity for name in ("roughness.Y", "metallic.Y")]))
    return np.stack(plates), np.stack(mattes), np.stack(truths, 1).astype(np.float32)


def predicted(folder, work):
    """Mean and standard deviation [2, T, H, W] of the embedded model's members; kept in `work`."""
    document = _elsewhere(folder)
    home = work / f"{folder.name}.{document['frames']}"
    home.mkdir(parents=True, exist_ok=True)
    (home / "shot.yaml").write_text(yaml.safe_dump(document))
    session = Session(home)
    plan, store = session.plan(), session.output.store
    FrameStore.create(store, plan.arrays(), session.job.frames, session.job.height, session.job.width)
    for node in full_frame_nodes(plan, Graph()):
        if not is_done(session.book, node):
            run_node(session.job, node)
    frames = range(len(session.job.frames))
    mean, spread = (
        np.stack([FrameStore(store).read(name, t) for t in frames], axis=1) for name in ("observed", "spread")
    )
    return mean, spread


def _elsewhere(folder):
    """The job of a shot, inputs by absolute paths, cut to the frames that are there."""
    document = yaml.safe_load((folder / "shot.yaml").read_text())
    numbers = [int(path.name.split(".")[1]) for path in sorted(folder.glob("plate.*.exr"))]
    document |= {"frames": f"{numbers[0]}-{numbers[-1]}", "output": "out"}
    document["camera"] = str(folder.absolute() / document["camera"])
    for name in PATHS:
        if document.get(name):
            document[name]["path"] = str(folder.absolute() / document[name]["path"])
    return document


def smooth_noise(rng, shape, radius, strength):
    noise = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), radius)
    return noise * strength / noise.std()


def ensemble(truth, strength, seed):
    """Mean and standard deviation [2, T, H, W] of noisy members."""
    rng, mean, std = np.random.default_rng(seed), np.zeros_like(truth), np.zeros_like(truth)
    for plane in np.ndindex(truth.shape[:2]):
        shared = smooth_noise(rng, truth.shape[2:], 8, 0.6 * strength)
        members = [
            truth[plane]
            + shared
            + smooth_noise(rng, truth.shape[2:], 5, strength)
            + 0.3 * strength * (rng.standard_normal(truth.shape[2:]) + rng.standard_normal())
            for _ in range(MEMBERS)
        ]
        members = np.clip(members, 0, 1)
        mean[plane], std[plane] = members.mean(0), members.std(0)
    return mean, std


def errors(value, truth, matte):
    """RMSE to the truth and RMSE of the frame-to-frame difference, [2 channels, 2]."""
    both, difference = matte[1:] & matte[:-1], np.diff(value - truth, axis=1)
    return np.array(
        [
            (np.sqrt(np.mean((v - t)[matte] ** 2)), np.sqrt(np.mean(d[both] ** 2)))
            for v, t, d in zip(value, truth, difference, strict=True)
        ]
    )
