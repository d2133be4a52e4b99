"""Runs the product's compositing script in Blender and writes what the compositor gives, a float EXR a frame.

The arguments are the factors of sun and rest, which the user would set, and the script.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import bpy

script = Path(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
runpy.run_path(str(script), run_name="__main__")
scene = bpy.context.scene
tree = scene.compositing_node_group if hasattr(scene, "compositing_node_group") else scene.node_tree
for name, factor in zip(("sun", "rest"), sys.argv[-3:-1], strict=True):
    for node in (node for node in tree.nodes if node.label == name):
        node.outputs[0].default_value = float(factor)
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
