"""Scenes for tests of single behaviours: `python odd_scenes.py FOLDER`, or with `blender -b --python`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
import target_scenes as made  # type: ignore[import-not-found]


def main() -> None:
    """Writes all."""
    folder = Path(sys.argv[-1]).resolve()
    for name, build in SCENES.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        build()
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{name}.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    made.plane("floor", (0, 0, 0), 12, made.paint("floor", (0.5, 0.5, 0.5), 0.8))
    bpy.ops.export_scene.gltf(filepath=str(folder / "floor.glb"))


def empty() -> None:
    """Nothing under a black world."""
    made.world_color((0, 0, 0))


def lamps() -> None:
    """A sun from -Y at 45 degrees and a point three metres away along +Y, too small to be hit by chance."""
    empty()
    made.lamp("SUN", (0, 0, 0), (45, 0, 0), 2.0, angle=math.radians(0.5))
    made.lamp("POINT", (0, 3, 0), (0, 0, 0), 100.0, shadow_soft_size=0.0)


def lacking() -> None:
    """A material with a picture that is not there."""
    material = made.paint("painted", (1, 1, 1), 0.5)
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("gone", 4, 4)
    texture.image.source, texture.image.filepath = "FILE", "//gone.exr"
    made.plane("floor", (0, 0, 0), 2, material)


def centimetres() -> None:
    """One unit is a centimetre."""
    bpy.context.scene.unit_settings.scale_length = 0.01


SCENES: dict[str, Callable[[], None]] = {
    "empty": empty, "lamps": lamps, "lacking": lacking, "centimetres": centimetres,
}  # fmt: skip

if __name__ == "__main__":
    main()
