"""Opens an Alembic file in Blender and exports one of its cameras with export_camera.py.

Called with a JSON request: abc, out, camera (a name or null), width, height, pixel_aspect, frames (numbers, or
none for those of the file), fps. Blender turns Alembic's Y-up world to Z-up. It reads the lens of the first frame only.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import export_camera


def main(request: dict[str, Any]) -> None:
    """Writes camera.json to the folder `out`."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = round(request["fps"] * 1001) if request["fps"] % 1 else int(request["fps"])
    scene.render.fps_base = 1001 if request["fps"] % 1 else 1
    scene.render.resolution_x, scene.render.resolution_y = request["width"], request["height"]
    scene.render.pixel_aspect_x = max(request["pixel_aspect"], 1)
    scene.render.pixel_aspect_y = max(1 / request["pixel_aspect"], 1)
    if "FINISHED" not in bpy.ops.wm.alembic_import(
        filepath=request["abc"], set_frame_range=True, as_background_job=False
    ):
        raise SystemExit("yesnt: Blender cannot read this Alembic file")
    cameras = [thing for thing in scene.objects if thing.type == "CAMERA"]
    named = [c for c in cameras if request["camera"] in (None, c.name, c.data.name)]
    if len(named) != 1:
        raise SystemExit(
            f"yesnt: expected one camera; the file has {sorted(c.name for c in cameras)}: name one by --camera"
        )
    scene.camera = named[0]
    scene.camera.data.sensor_fit = "HORIZONTAL"
    export_camera.main(["--out", request["out"], "--frames", ",".join(map(str, request["frames"]))])


if __name__ == "__main__":
    with open(sys.argv[-1], encoding="utf-8") as source:
        main(json.load(source))
