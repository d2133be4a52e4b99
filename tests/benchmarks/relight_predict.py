"""Predicted against true error of shared visibility, and what the default's choice of clusters costs against truth.

    python tests/benchmarks/relight_predict.py STAGE/objects SUBJECT,... MAP,... [FRAME]

True error: display root mean square, inside the matte, to 1,024 clusters. `constant` is the SHARE (relight/predict.py)
that would have foretold it. Cost: PSNR to the rendered truth with 512 clusters minus that with the default's choice.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from relight_ladder import load, psnr

from yesnt.core.color import srgb_encode
from yesnt.relight import EnvMap, RelightSettings, prepare_capture, prepare_relight, relight_frame
from yesnt.relight.predict import SHARE

MOST = 1024
STANDARD = RelightSettings()


def measure(folder, name, frame, ratios, costs):
    inputs, proxy, truths = load(folder, frame, [name])
    env, matte = EnvMap.open(folder / "env" / f"{name}.exr"), inputs.surface.opacity > 0.99
    capture = prepare_capture(EnvMap.open(folder / "env" / "capture.exr"), STANDARD)
    shown, scores, lights = {}, {}, {}
    for count in (64, 256, 512, MOST, 0):  # 0: what the default chooses
        settings = replace(STANDARD, clusters=count, error=0.0) if count else STANDARD
        lights[count] = prepare_relight(env, settings)
        relit = relight_frame(inputs, lights[count], capture, proxy, settings).radiance
        shown[count], scores[count] = srgb_encode(relit)[matte], psnr(relit, truths[name], matte)
    cost = scores[512] - scores[0]
    costs.append(cost)
    for count in (64, 256, 512):
        true, told = float(np.sqrt(np.square(shown[count] - shown[MOST]).mean())), lights[count].shadow_error
        ratios.append(SHARE * true / told)
        print(f"{folder.name} / {name}: {count} clusters, told {told:.4f}, true {true:.4f}, constant {ratios[-1]:.3f}")
    print(f"{folder.name} / {name}: default takes {len(lights[0].clusters)} and costs {cost:+.2f} dB", flush=True)


def main(root, subjects, maps, frame=1001):
    ratios, costs = [], []
    for subject in subjects:
        for name in maps:
            measure(root / subject, name, frame, ratios, costs)
    low, middle, high = np.percentile(ratios, [0, 50, 100])
    print(f"constant: median {middle:.3f}, {low:.3f} to {high:.3f}; now {SHARE}")
    print(f"cost of the default against 512 clusters: mean {np.mean(costs):+.3f} dB, worst {max(costs):+.3f} dB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(arg.split(",") for arg in sys.argv[2:4]), *map(int, sys.argv[4:]))
