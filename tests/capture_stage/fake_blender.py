"""Stands in for Blender: reads a request and writes raw pictures of a disc; dies when told to.

Called as a Blender program is: `fake --background --python main.py -- request.json`.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np
import OpenEXR


def passes(width, height, frame):
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    disc = (np.hypot(x - width / 2, y - height / 2) < height / 3).astype(np.float32)
    out = {f"Combined.{c}": disc * (0.3 + 0.01 * (frame % 10)) for c in "RGB"}
    out |= {"Combined.A": disc, "Depth.Z": np.where(disc > 0, np.float32(2), np.float32(1e10))}
    out |= {"Normal.X": 0 * disc, "Normal.Y": -disc, "Normal.Z": 0 * disc}
    out |= {f"Vector.{c}": disc for c in "XYZW"}
    out |= {f"base_color.{c}": 0.5 * disc for c in "RGB"}
    out |= {"roughness.X": 0.5 * disc, "metallic.X": 0 * disc}
    return {f"ViewLayer.{name}": np.ascontiguousarray(plane, dtype=np.float32) for name, plane in out.items()}


def main():
    request = json.loads(Path(sys.argv[-1]).read_text())
    counter = Path(os.environ["FAKE_BLENDER_COUNTER"])
    done, limit = int(counter.read_text()), int(os.environ.get("FAKE_BLENDER_LIMIT", "1000"))
    for render in request["renders"]:
        if done >= limit:
            sys.stderr.write("out of luck\n")
            sys.exit(7)
        if render["what"] in ("proxy", "mesh"):
            Path(render["out"]).write_bytes(b"ply\n")
        else:
            header = {"type": OpenEXR.scanlineimage}
            with OpenEXR.File(header, passes(request["width"], request["height"], render["frame"])) as picture:
                picture.write(render["out"])
        done += 1
        counter.write_text(str(done))


if __name__ == "__main__":
    main()
