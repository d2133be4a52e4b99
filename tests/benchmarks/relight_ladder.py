"""What each term of relighting is worth: display PSNR inside the matte against rendered truth, with true materials.

    python tests/benchmarks/relight_ladder.py FOLDER [FIRST-LASTxSTEP] [short]

`short`: only standard quality, without and with shadows and pixel filter.

FOLDER holds a shot with `truth/material.####.exr` and `truth/relit_NAME.####.exr` for maps `env/NAME.exr`. Matte:
opacity > 0.99; sRGB, clipped to [0, 1]; PSNR of each frame, mean over frames.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from yesnt.core.camera import Camera
from yesnt.core.color import srgb_encode, straighten
from yesnt.io.mesh import read_mesh
from yesnt.io.pictures.image import read_image
from yesnt.relight import (
    EnvMap,
    FrameInputs,
    ProxyScene,
    RelightSettings,
    Surface,
    prepare_capture,
    prepare_relight,
    relight_frame,
)

STANDARD = RelightSettings()
POINTS = replace(STANDARD, edges=False, pixel_filter=0.0)
OPEN = replace(POINTS, shadows=False)
RUNGS = {  # name: (settings, with proxy, roughness or None for the true one)
    "paper's base, no shadow": (replace(OPEN, base_color="plate", brdf="paper"), False, None),
    "the paper's single factor": (replace(POINTS, base_color="plate", brdf="paper", shadows="single"), False, None),
    "capture light removed": (replace(OPEN, brdf="paper"), False, None),
    "+ Cycles' energy terms": (OPEN, False, None),
    "+ visibility marched in z": (POINTS, False, None),
    "+ visibility from the proxy": (replace(POINTS, bounce=0), True, None),
    "+ two bounces": (POINTS, True, None),
    "+ edges resolved": (replace(STANDARD, pixel_filter=0.0), True, None),
    "+ pixel filter = standard": (STANDARD, True, None),
    "draft": (RelightSettings.from_quality("draft"), True, None),
    "final": (RelightSettings.from_quality("final"), True, None),
    "standard, roughness 0.5": (STANDARD, True, 0.5),
}


def rgb(channels, prefix=""):
    return np.stack([channels[prefix + c] for c in "RGB"], -1).astype(np.float32)


def load(folder, frame, maps):
    """Inputs, proxy and truths of one frame."""
    plate, gbuffer, material = (
        read_image(folder / f"{name}.{frame}.exr").channels for name in ("plate", "gbuffer", "truth/material")
    )
    opacity = plate["A"]
    normal = np.stack([gbuffer[f"N.{axis}"] for axis in "XYZ"], -1).astype(np.float32)
    camera = Camera.open(folder / "camera.json")
    surface = Surface(
        normal, gbuffer["depth.Z"], opacity, material["roughness.Y"], material["metallic.Y"], camera, frame
    )
    mesh = read_mesh(folder / f"proxy.{frame}.ply")
    truths = {n: rgb(read_image(folder / f"truth/relit_{n}.{frame}.exr").channels) for n in maps}
    truths = {n: straighten(t, opacity) for n, t in truths.items()}
    return (
        FrameInputs(straighten(rgb(plate), opacity), surface),
        ProxyScene.from_arrays(mesh.vertices, mesh.faces),
        truths,
    )


def psnr(found, truth, matte):
    error = (srgb_encode(found.astype(np.float64)) - srgb_encode(truth.astype(np.float64)))[matte]
    return -10 * np.log10(np.square(error).mean())


FREE, WHOLE = "+ Cycles' energy terms", "+ pixel filter = standard"


def main(folder, frames, rungs):
    found = (folder / "truth").glob(f"relit_*.{frames[0]}.exr")
    maps = sorted(path.name.removeprefix("relit_").split(".")[0] for path in found)
    envs = {n: EnvMap.open(folder / "env" / f"{n}.exr") for n in [*maps, "capture"]}
    scores = {name: np.zeros((len(frames), len(maps))) for name in ["unlit plate", *rungs]}
    seconds = dict.fromkeys(scores, 0.0)
    lights = {
        name: ({n: prepare_relight(envs[n], s) for n in maps}, prepare_capture(envs["capture"], s))
        for name, (s, _, _) in rungs.items()
    }
    for i, frame in enumerate(frames):
        inputs, proxy, truths = load(folder, frame, maps)
        matte = inputs.surface.opacity > 0.99
        scores["unlit plate"][i] = [psnr(inputs.plate, truths[n], matte) for n in maps]
        for name, (settings, meshed, roughness) in rungs.items():
            rough = inputs.surface.roughness if roughness is None else np.full(matte.shape, roughness, np.float32)
            given = replace(inputs, surface=replace(inputs.surface, roughness=rough))
            for j, n in enumerate(maps):
                started = time.process_time()
                relit = relight_frame(given, lights[name][0][n], lights[name][1], proxy if meshed else None, settings)
                seconds[name] += time.process_time() - started
                scores[name][i, j] = psnr(relit.radiance, truths[n], matte)
    runs = len(frames) * len(maps)
    print(f"{len(frames)} frames; dB by map {maps}, their mean, the worst frame's mean; CPU seconds a frame")
    for name, table in scores.items():
        row = "  ".join(f"{v:6.2f}" for v in table.mean(0))
        print(f"{name:32s} {row}   {table.mean():6.2f}   {table.mean(1).min():6.2f}   {seconds[name] / runs:6.2f}")
    gain = scores[WHOLE] - scores[FREE]
    print(f"with shadows minus without, worst frame and map: {gain.min():+.2f} dB")


if __name__ == "__main__":
    span, _, step = (sys.argv[2] if len(sys.argv) > 2 else "1001-1012").partition("x")
    first, _, last = span.partition("-")
    chosen = {name: RUNGS[name] for name in (FREE, "+ edges resolved", WHOLE)} if sys.argv[3:] == ["short"] else RUNGS
    main(Path(sys.argv[1]), list(range(int(first), int(last or first) + 1, int(step or 1))), chosen)
