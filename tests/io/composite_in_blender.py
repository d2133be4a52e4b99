"""Runs the product's compositing script in Blender and writes what the compositor gives, a float EXR a frame."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import bpy

script = Path(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
runpy.run_path(str(script), run_name="__main__")
scene = bpy.context.scene
scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(scene.camera)
scene.render.engine, scene.cycles.samples = "CYCLES", 1
settings = scene.render.image_settings
if hasattr(settings, "media_type"):
    settings.media_type = "IMAGE"
settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
for frame in range(scene.frame_start, scene.frame_end + 1):
    scene.frame_set(frame)
    scene.render.filepath = str(script.parent / f"composited.{frame}.exr")
    bpy.ops.render.render(write_still=True)
