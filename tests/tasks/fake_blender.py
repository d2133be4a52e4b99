"""Stands in for Blender on a set: flat pictures, and a column of the set before the left of the picture.

Called as a Blender program is: `fake --background ... --python main.py -- request.json`.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np
import OpenEXR


def write(path, planes):
    named = {f"ViewLayer.{name}": np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, named) as picture:
        picture.write(path)


def plate(size, value):
    flat = np.full(size, value, np.float32)
    planes = {f"Combined.{c}": flat * gain for c, gain in zip("RGB", (1, 0.8, 0.6), strict=True)}
    return planes | {f"{name}.{c}": 0 * flat for name in ("GlossDir", "GlossInd", "GlossCol") for c in "RGB"}


def main():
    request = json.loads(Path(sys.argv[-1]).read_text())
    log = Path(os.environ["FAKE_BLENDER_LOG"])
    log.write_text(log.read_text() + json.dumps(request) + "\n" if log.exists() else json.dumps(request) + "\n")
    out = request["out"]
    if request["what"] == "facts":
        files = [str(Path(request["scene"]).with_name("wood.png"))]
        version = json.loads(os.environ.get("FAKE_BLENDER_VERSION", "[5, 0, 1]"))
        found = {"files": files, "working_space": "Linear Rec.709", "denoises": True, "version": version}
        Path(out["facts"]).write_text(json.dumps(found))
    elif request["what"] == "bake":
        write(out["map"], plate((request["rows"], 2 * request["rows"]), 0.7))
    else:
        height, width = request["camera"]["height"], request["camera"]["width"]
        write(out["without"], plate((height, width), 0.5))
        if os.environ.get("FAKE_BLENDER_DIES"):
            sys.exit(7)
        write(out["with"], plate((height, width), 0.4))
        n = request["depth_factor"]
        x = np.broadcast_to(np.arange(width * n), (height * n, width * n))
        write(out["depth"], {"Depth.Z": np.where(x < width * n // 2, 1.0, 1e10)})


main()
