"""What edges cost against Cycles: the extended light, and the composite in display space instead of linear light.

    python tests/benchmarks/composite_edges.py FOLDER [FIRST-LASTxSTEP]

FOLDER is as for `relight_ladder.py`. The subject is laid over the map behind it. Truth is Cycles' own picture of the
relit subject, whose edges mix light, over the same map. Display PSNR (sRGB, cut at 1) over the pixels whose coverage is
between 0.02 and 0.98, mean over frames and maps. With true materials.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.benchmarks.relight_ladder import load
from yesnt.core.color import srgb_encode
from yesnt.io.jobfile import parse_frames
from yesnt.relight import EnvMap, RelightSettings, prepare_capture, prepare_relight, relight_frame
from yesnt.scene.composite import associate, over, over_in_display

STANDARD = RelightSettings()
BLENDS = {"linear": over, "display": over_in_display}


def main():
    folder = Path(sys.argv[1])
    frames = parse_frames(sys.argv[2] if len(sys.argv) > 2 else "1001-1016x5", "frames")
    maps = sorted({path.name.split(".")[0].removeprefix("relit_") for path in folder.glob("truth/relit_*")})
    envs = {name: EnvMap.open(folder / f"env/{name}.exr") for name in maps}
    capture = prepare_capture(EnvMap.open(folder / "env/capture.exr"), STANDARD)
    lights = {name: prepare_relight(env, STANDARD) for name, env in envs.items()}
    found = {}
    for frame in frames:
        inputs, proxy, truths = load(folder, frame, maps)
        alpha = np.asarray(inputs.surface.opacity, np.float32)
        edge = (alpha > 0.02) & (alpha < 0.98)
        for name in maps:
            back = envs[name].lookup(inputs.surface.camera.rays(frame))
            exact = over(associate(truths[name], alpha), back)[..., :3]
            pictures = {"true light": truths[name]}
            for label, extend in (("own light", False), ("extended light", True)):
                settings = replace(STANDARD, extend=extend)
                pictures[label] = relight_frame(inputs, lights[name], capture, proxy, settings).radiance
            for label, light in pictures.items():
                for kind, blend in BLENDS.items():
                    picture = blend(associate(light, alpha), back)[..., :3]
                    found.setdefault((label, kind), []).append(psnr(picture, exact, edge))
    for (label, kind), values in found.items():
        print(f"{label:15s} {kind:8s} {np.mean(values):6.2f} dB  " + " ".join(f"{v:.2f}" for v in values))


def psnr(picture, exact, where):
    error = (srgb_encode(picture.astype(np.float64)) - srgb_encode(exact.astype(np.float64)))[where]
    return -10 * np.log10(max(np.square(error).mean(), 1e-20))


if __name__ == "__main__":
    main()
