"""Processor seconds per frame and peak memory of each stage against resolution, and of a run against its length.

python tests/benchmarks/evaluation_scaling.py [--sizes 480x270,960x540] [--stages fit_step,view] [--lengths 16,64]
    [--quality draft] [--out DIR]

Every figure comes from a process of its own, pinned to one thread, on a made-up scene: a sphere that covers 23 % of the
picture, an 8,000-triangle proxy, two 512x256 maps. Kernels run twice and the second time counts, so that compiling does
not. Seconds are processor time, so that other work on the machine counts little. Writes scaling.json and scaling.svg
after every figure and keeps what it finds there, so it may be stopped; the defaults go to 3840x2160 and 256 frames and
take about an hour.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIZES = "480x270,960x540,1920x1080,3840x2160"
LENGTHS = "16,32,64,128,256"
STAGES = ("decompose", "flow", "solve", "relight", "composite", "fit_step", "view")
CHUNK = 4
"""Frames that the solve is measured on; its time per frame hardly depends on them."""

GAUSSIANS, STEPS = 15_000, 8
"""Of the field that is fitted and rendered; steps that are timed, one a camera."""


def scene(width, height):
    """A sphere 3 m before the camera: camera, matte, z, normal, plate."""
    import numpy as np

    from yesnt.core.camera import Camera

    pose = {"1": {"world_from_camera": [[1, 0, 0, 0], [0, 0, 1, -3], [0, -1, 0, 0], [0, 0, 0, 1]]}}
    intrinsics = {"fx": 1.03 * height, "fy": 1.03 * height, "cx": width / 2, "cy": height / 2}
    camera = Camera.from_dict({"width": width, "height": height, **intrinsics, "frames": pose})
    rays = camera.rays()
    a, b, c = (rays**2).sum(-1), 2 * rays @ np.float32([0, -3, 0]), np.float32(8)
    root = b * b - 4 * a * c
    matte = (root > 0).astype(np.float32)
    z = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / (2 * a), 0).astype(np.float32)
    normal = ((np.float32([0, -3, 0]) + z[..., None] * rays) * matte[..., None]).astype(np.float32)
    plate = ((0.4 + 0.2 * np.sin(40 * normal)) * matte[..., None]).astype(np.float32)
    return camera, matte, z, normal, plate


def env(seed):
    import numpy as np

    from yesnt.relight import EnvMap

    radiance = np.random.default_rng(seed).random((256, 512, 3), dtype=np.float32)
    radiance[60:64, 100:104] = 500
    return EnvMap.from_array(radiance)


def decompose(width, height, quality):
    from yesnt.decompose.embedded import EmbeddedBackend
    from yesnt.decompose.ensemble import estimate_frame
    from yesnt.decompose.settings import EnsembleSettings

    _, matte, _, _, plate = scene(width, height)
    backend = EmbeddedBackend()
    return lambda: estimate_frame(plate, matte, backend, EnsembleSettings(samples=8), 0, 1), 1


def flow(width, height, quality):
    import numpy as np

    from yesnt.temporal import FlowSettings, flow_and_validity

    _, matte, _, _, plate = scene(width, height)
    return lambda: flow_and_validity(plate, np.roll(plate, 3, 1), matte, np.roll(matte, 3, 1), FlowSettings()), 1


def solve(width, height, quality):
    import numpy as np

    from yesnt.temporal import EnergyParams
    from yesnt.temporal import solve as run

    _, matte, _, _, plate = scene(width, height)
    rng = np.random.default_rng(0)
    truth = np.broadcast_to(plate[..., :2].transpose(2, 0, 1)[:, None], (2, CHUNK, height, width))
    noise = 0.1 * rng.standard_normal(truth.shape, dtype=np.float32)
    confidence = rng.random(truth.shape, dtype=np.float32)
    still, valid = np.zeros((CHUNK - 1, height, width, 2), np.float32), np.ones((CHUNK - 1, height, width), np.float32)
    mattes = np.broadcast_to(matte > 0.5, (CHUNK, height, width))
    return lambda: run(truth + noise, confidence, still, valid, EnergyParams(), mattes), CHUNK


def relight(width, height, quality):
    import numpy as np
    import trimesh

    from yesnt.relight import (
        FrameInputs,
        ProxyScene,
        RelightSettings,
        Surface,
        prepare_capture,
        prepare_relight,
        relight_frame,
    )  # fmt: skip

    camera, matte, z, normal, plate = scene(width, height)
    settings = RelightSettings.from_quality(quality)
    light, capture = prepare_relight(env(0), settings), prepare_capture(env(1), settings)
    ball = trimesh.creation.uv_sphere(count=(64, 64))
    proxy = ProxyScene.from_arrays(ball.vertices, ball.faces)
    rough = np.full_like(matte, 0.5)
    surface = Surface(normal, z, matte, rough, 0.2 * rough, camera)
    return lambda: relight_frame(FrameInputs(plate, surface), light, capture, proxy, settings), 1


def composite(width, height, quality):
    import numpy as np

    from yesnt.scene.composite import associate, over

    _, matte, _, _, plate = scene(width, height)
    return lambda: over(associate(plate, matte), np.ones_like(plate)), 1


def ball_cameras(width, height):
    """The cameras of `scene` all around the sphere, and what each sees: targets of a fit with whole pictures."""
    import numpy as np

    from yesnt.core.camera import Camera
    from yesnt.gaussians.records import View
    from yesnt.gaussians.targets import Target

    camera, matte, _, normal, _ = scene(width, height)
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    targets = []
    for angle in 2 * np.pi * np.arange(STEPS) / STEPS:
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose = {"1": {"world_from_camera": (turn @ camera.pose()).ravel().tolist()}}
        turned = normal @ turn[:3, :3].T.astype(np.float32)
        color = ((0.5 + 0.4 * np.sin(9 * turned)) * matte[..., None]).astype(np.float32)
        view = View.of(Camera.from_dict({**{k: getattr(camera, k) for k in keys}, "frames": pose}))
        targets.append(Target.cropped(view, color, matte))
    return camera, targets


def ball_field(targets):
    """Discs evenly spread over the sphere (Fibonacci's spiral), and the points."""
    import numpy as np

    from yesnt.gaussians.initial import discs

    z = 1 - (2 * np.arange(GAUSSIANS) + 1) / GAUSSIANS
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(GAUSSIANS)
    points = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)
    return discs(points, points, targets, GAUSSIANS, 1), points


def fit_step(width, height, quality):
    """One step of a fit at full resolution, with all losses."""
    from yesnt.gaussians.fit import Pictures, take_step
    from yesnt.gaussians.fit_state import FitState
    from yesnt.gaussians.initial import pixel_width
    from yesnt.gaussians.settings import FitSettings

    _, targets = ball_cameras(width, height)
    field, points = ball_field(targets)
    state, pictures = FitState.of(field, 2.0, pixel_width(points, targets)), Pictures(targets, ())
    settings = FitSettings(half=0, geometry_from=0, every=10_000)

    def steps():
        for _ in range(STEPS):
            take_step(state, pictures, settings, 1)

    return steps, STEPS


def view(width, height, quality):
    """The field as plate and G-buffer."""
    from yesnt.gaussians.render import render

    camera, targets = ball_cameras(width, height)
    field, _ = ball_field(targets)
    return lambda: render(field, camera), 1


def run(length, folder):
    """Materials read, flow, chunked solve of a whole shot, task after task as a worker does them; 240x135."""
    from yesnt.runtime.session import Session
    from yesnt.tasks.run import run_node

    session = Session(write_shot(folder, length))
    graph = session.graph()
    graph = graph.closure([node.id for node in graph if node.stage.label == "solve"])
    from yesnt.io.store import FrameStore

    job = session.job
    FrameStore.create(session.output.store, session.plan().arrays(), job.frames, job.height, job.width)
    for node in graph:
        run_node(job, node)


def write_shot(folder, length):
    import numpy as np

    from yesnt.io.exr import write_exr

    camera, matte, z, normal, plate = scene(240, 135)
    write_exr(folder / "plate.exr", {**{c: plate[..., i] for i, c in enumerate("RGB")}, "A": matte})
    write_exr(folder / "g.exr", {"depth.Z": z, **{f"N.{a}": normal[..., i] for i, a in enumerate("XYZ")}})
    names = ("roughness.Y", "metallic.Y", "roughness_std.Y", "metallic_std.Y")
    noise = np.random.default_rng(0).random((4, *matte.shape), dtype=np.float32)
    write_exr(folder / "m.exr", dict(zip(names, noise * np.float32([1, 1, 0.4, 0.4])[:, None, None], strict=True)))
    write_exr(folder / "env.exr", {c: np.ones((8, 16), np.float32) for c in "RGB"})
    document = {k: getattr(camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    poses = {str(f): {"world_from_camera": camera.pose().tolist()} for f in range(1, length + 1)}
    (folder / "camera.json").write_text(json.dumps({**document, "frames": poses}))
    (folder / "shot.yaml").write_text(
        f"version: 1\nname: long\nframes: 1-{length}\nplate: {{path: plate.exr}}\ngbuffer: {{path: g.exr}}\n"
        "camera: camera.json\nlight: {path: env.exr}\ndecompose: {path: m.exr}\n"
    )
    return folder


def measure(what, argument, quality):
    """In a child process: prints seconds per frame and peak memory."""
    if what == "run":
        with tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            run(int(argument), Path(folder))
            seconds = (time.process_time() - start) / int(argument)
    else:
        width, height = map(int, argument.split("x"))
        work, frames = globals()[what](width, height, quality)
        for _ in range(2 if width < 3000 else 1):  # at 4K compiling is lost in the work
            start = time.process_time()
            work()
            seconds = (time.process_time() - start) / frames
    print(json.dumps({"seconds": seconds, "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024}))


def child(what, argument, quality):
    variables = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    command = [sys.executable, __file__, "--measure", what, argument, "--quality", quality]
    done = subprocess.run(
        command, env={**os.environ, **dict.fromkeys(variables, "1")}, capture_output=True, text=True, check=False
    )  # fmt: skip
    if done.returncode:
        print(f"{what} {argument}: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return None
    found = json.loads(done.stdout.splitlines()[-1])
    print(f"{what:10} {argument:10} {found['seconds']:9.3f} s/frame {found['peak_bytes'] / 1e9:6.2f} GB", flush=True)
    return found


def plot(title, unit, series):
    """A log-log plot as SVG: {name: [(x, y)]}."""
    points = [p for curve in series.values() for p in curve]
    low, high = ([f(math.log10(p[i]) for p in points) for i in (0, 1)] for f in (min, max))
    span = [max(h - a, 0.3) for a, h in zip(low, high, strict=True)]
    colors = ("#1f5fbf", "#c1440e", "#2e7d32", "#7b1fa2", "#555", "#b8860b", "#00838f")

    def at(point):
        x, y = ((math.log10(v) - low[i]) / span[i] for i, v in enumerate(point))
        return 60 + 300 * x, 230 - 190 * y

    parts = [
        f'<text x="60" y="20" font-weight="600">{title}</text><path d="M60 30V230H380" fill="none" stroke="#333"/>'
    ]
    for (name, curve), color in zip(series.items(), colors, strict=False):
        line = " ".join("{:.1f},{:.1f}".format(*at(p)) for p in curve)
        x, y = at(curve[-1])
        parts.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="2"/>')
        parts.append(f'<text x="{x + 6:.0f}" y="{y + 4:.0f}" fill="{color}">{name}</text>')
    for x in sorted({p[0] for p in points}):
        parts.append(f'<text x="{at((x, points[0][1]))[0]:.0f}" y="248" text-anchor="middle">{x:g}</text>')
    for y in (10 ** low[1], 10 ** high[1]):
        parts.append(f'<text x="54" y="{at((points[0][0], y))[1]:.0f}" text-anchor="end">{y:.2g}</text>')
    return "<g>" + "".join(parts) + f'<text x="60" y="266">{unit}</text></g>'


def draw(path, found):
    pixels = {size: math.prod(map(int, size.split("x"))) / 1e6 for stage in found["stages"].values() for size in stage}
    curves = {
        key: {
            stage: [(pixels[size], values[key] / scale) for size, values in sizes.items()]
            for stage, sizes in found["stages"].items() if sizes
        }
        for key, scale in (("seconds", 1), ("peak_bytes", 1e9))
    }  # fmt: skip
    panels = [plot("Processor seconds per frame", "megapixels; one core", curves["seconds"])]
    panels.append(plot("Peak memory of a task, GB", "megapixels", curves["peak_bytes"]))
    if found["lengths"]:
        line = [(int(n), v["peak_bytes"] / 1e9) for n, v in found["lengths"].items()]
        panels.append(plot("Peak memory of a worker, GB", "frames of a shot, 240x135", {"materials to solve": line}))
    moved = "".join(f'<g transform="translate({460 * i} 0)">{panel}</g>' for i, panel in enumerate(panels))
    frame = f'viewBox="0 0 {460 * len(panels)} 280" font-family="sans-serif" font-size="12"'
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {frame}>{moved}</svg>')


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default=SIZES)
    parser.add_argument("--stages", default=",".join(STAGES))
    parser.add_argument("--lengths", default=LENGTHS)
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "yesnt-scaling")
    parser.add_argument("--measure", nargs=2, metavar=("STAGE", "SIZE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measure(*options.measure, options.quality)
        return
    texts = (options.sizes, options.stages, options.lengths)
    sizes, stages, lengths = (tuple(filter(None, text.split(","))) for text in texts)
    for what, argument in [(stage, size) for size in sizes for stage in stages] + [("run", n) for n in lengths]:
        found = known(options)
        place = found["lengths"] if what == "run" else found["stages"].setdefault(what, {})
        if argument not in place and (one := child(what, argument, options.quality)) is not None:
            place[argument] = one
            (options.out / "scaling.json").write_text(json.dumps(found, indent=1))
            draw(options.out / "scaling.svg", found)
    print(f"Written: {options.out}/scaling.json and scaling.svg")


def known(options):
    """What was measured before at this quality."""
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "scaling.json"
    found = json.loads(path.read_text()) if path.is_file() else {}
    empty = {"quality": options.quality, "stages": {stage: {} for stage in STAGES}, "lengths": {}}
    return found if found.get("quality") == options.quality else empty


if __name__ == "__main__":
    main()
