"""A small scene as a Blender user has it: `python scene.py EXPORT FOLDER`, or `blender -b --python scene.py -- ...`.

EXPORT is the script that `yesnt camera --blender-script` prints.

Three subjects of different roughness and metal under an even capture light, and the truth under a map. Everything is
written as Blender writes it: multi-layer EXRs, and a PNG sequence with a separate matte. A picture that is there is
not rendered again.
"""

from __future__ import annotations

import math
import os
import runpy
import sys
from pathlib import Path
from typing import Any

import bpy

WIDTH, HEIGHT = 192, 144
FRAMES = range(1001, 1004)
SAMPLES = 256
SUBJECTS = "Subjects"
MATERIALS: dict[str, tuple[tuple[float, float, float], float, float]] = {
    "head": ((0.60, 0.25, 0.12), 0.45, 0.0),
    "ball": ((0.90, 0.80, 0.55), 0.30, 1.0),
    "vase": ((0.10, 0.25, 0.55), 0.80, 0.0),
}
"""Base colour, roughness and metallic of each object."""


def main() -> None:
    """Renders whatever is missing in the folder that the command line names."""
    export, folder = (Path(argument).resolve() for argument in sys.argv[-2:])
    folder.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _settings()
    _objects()
    _camera()
    _passes()
    _export(export, folder)
    light = _light_map(folder / "light.exr")
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        _render_capture(folder, frame)
        _render_truth(folder / f"truth.{frame}.exr", light)


def _settings() -> None:
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", SAMPLES, False
    scene.cycles.sample_clamp_indirect = scene.cycles.blur_glossy = 0.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.film_transparent = True
    scene.render.use_persistent_data = True
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.frame_start, scene.frame_end, scene.render.fps = FRAMES[0], FRAMES[-1], 24
    # AgX, Blender's default view, would be baked into the PNGs, and they would not be sRGB pictures of the radiance.
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True


def _objects() -> None:
    collection = bpy.data.collections.new(SUBJECTS)
    bpy.context.scene.collection.children.link(collection)
    layers = bpy.context.view_layer.layer_collection
    bpy.context.view_layer.active_layer_collection = layers.children[SUBJECTS]
    add = bpy.ops.mesh
    add.primitive_monkey_add(location=(0, 0, 1.1))
    _finish("head", 2, "rotation_euler", (0, 0, math.radians(-20)), (0, 0, math.radians(-12)))
    add.primitive_uv_sphere_add(radius=0.55, segments=64, ring_count=32)
    _finish("ball", 0, "location", (1.5, -0.6, 0.7), (1.4, -0.6, 0.7))
    add.primitive_torus_add(
        location=(-1.6, 0, 1.0), rotation=(math.radians(60), 0, 0.4), major_radius=0.65, minor_radius=0.28,
        major_segments=96, minor_segments=32,
    )  # fmt: skip
    _finish("vase", 0, "location", (-1.6, 0, 1.0), (-1.55, 0, 1.05))


def _finish(name: str, levels: int, path: str, first: Any, last: Any) -> None:
    """Names, smooths, paints and animates the active object."""
    made = bpy.context.object
    made.name = name
    if levels:
        modifier = made.modifiers.new("smooth", "SUBSURF")
        modifier.levels = modifier.render_levels = levels
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    color, roughness, metallic = MATERIALS[name]
    inputs["Base Color"].default_value = (*color, 1)
    inputs["Roughness"].default_value, inputs["Metallic"].default_value = roughness, metallic
    made.data.materials.append(material)
    for frame, value in ((FRAMES[0], first), (FRAMES[-1], last)):
        setattr(made, path, value)
        made.keyframe_insert(path, frame=frame)


def _camera() -> None:
    bpy.context.view_layer.active_layer_collection = bpy.context.view_layer.layer_collection
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    camera = bpy.context.object
    camera.name, camera.data.lens = "camera", 50
    bpy.context.scene.camera = camera
    for frame, x in ((FRAMES[0], -0.1), (FRAMES[-1], 0.1)):
        camera.location = (x, -7, 1.5)
        camera.keyframe_insert("location", frame=frame)


def _export(script: Path, folder: Path) -> None:
    """Camera and proxies by the script that the product prints."""
    frames = f"{FRAMES[0]}-{FRAMES[-1]}"
    runpy.run_path(str(script))["main"](["--out", str(folder), "--proxy", SUBJECTS, "--frames", frames])


def _passes() -> None:
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_cryptomatte_object = True
    layer.pass_cryptomatte_depth = 4


def _light_map(path: Path) -> Any:
    """A studio: a warm soft box, a cool window and a dim floor and ceiling, lat-long, scene-linear."""
    height, width = 64, 128
    image = bpy.data.images.new("studio", width, height, float_buffer=True, is_data=True)  # as given: scene-linear
    pixels = [value for y in range(height) for x in range(width) for value in (*_studio(x / width, y / height), 1.0)]
    image.pixels = pixels
    if not path.exists():
        _write(image, path, "OPEN_EXR", "RGB", "32")
    return image


def _studio(u: float, v: float) -> tuple[float, float, float]:
    """Radiance at a column and a row counted from below, both in [0, 1)."""
    if 0.18 < u < 0.32 and 0.55 < v < 0.8:
        return (9.0, 7.5, 5.5)
    if 0.70 < u < 0.88 and 0.45 < v < 0.75:
        return (1.5, 2.6, 4.5)
    return (0.12 + 0.3 * v, 0.14 + 0.3 * v, 0.16 + 0.35 * v)


def _render_capture(folder: Path, frame: int) -> None:
    """One render under the even light: the multi-layer EXR, and the same as PNGs: colour alone, and the matte."""
    final = folder / f"render.{frame}.exr"
    if final.exists():
        return
    tree = bpy.context.scene.world.node_tree
    background = tree.nodes["Background"]
    for link in list(background.inputs["Color"].links):
        tree.links.remove(link)
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    bpy.ops.render.render()
    _save(folder / f"color.{frame}.png", "PNG", "RGB", "8")
    _save(folder / f"both.{frame}.png", "PNG", "RGBA", "8")
    _write_matte(folder / f"both.{frame}.png", folder / f"matte.{frame}.png")
    _save(final, "OPEN_EXR_MULTILAYER", "RGBA", "16")


def _write_matte(source: Path, final: Path) -> None:
    """The alpha of a picture as a picture of its own, as it is."""
    both = bpy.data.images.load(str(source))
    width, height = both.size
    matte = bpy.data.images.new("matte", width, height, is_data=True)
    alpha = list(both.pixels)[3::4]
    matte.pixels = [value for share in alpha for value in (share, share, share, 1.0)]
    view = bpy.context.scene.view_settings
    view.view_transform = "Raw"
    _write(matte, final, "PNG", "BW", "8")
    view.view_transform = "Standard"
    for image in (both, matte):
        bpy.data.images.remove(image)


def _render_truth(final: Path, light: Any) -> None:
    if final.exists():
        return
    tree = bpy.context.scene.world.node_tree
    texture = tree.nodes.get("map") or tree.nodes.new("ShaderNodeTexEnvironment")
    texture.name, texture.image = "map", light
    tree.links.new(texture.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    bpy.ops.render.render()
    _save(final, "OPEN_EXR", "RGBA", "16")


def _save(final: Path, kind: str, mode: str, depth: str) -> None:
    """Writes the last render."""
    _write(bpy.data.images["Render Result"], final, kind, mode, depth)


def _write(image: Any, final: Path, kind: str, mode: str, depth: str) -> None:
    """Writes an image through the scene's view (of EXR: as it is), and names it when it is whole."""
    settings = bpy.context.scene.render.image_settings
    if hasattr(settings, "media_type"):  # from Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE" if kind.endswith("MULTILAYER") else "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = kind, mode, depth
    temporary = final.with_name(f"part{os.getpid()}.{final.name}")
    image.save_render(str(temporary))
    temporary.replace(final)


if __name__ == "__main__":
    main()
