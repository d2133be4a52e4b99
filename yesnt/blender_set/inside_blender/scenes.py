"""Opens the user's scene, sets the renderer, places the shot's camera, and says what the host must know of it."""

from __future__ import annotations

import importlib.util
import math
import os
from pathlib import Path
from typing import Any

import bpy
import versions  # type: ignore[import-not-found]
from mathutils import Matrix

_OPENCV_TO_BLENDER = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
_SENSOR = 36.0  # millimetres; only its ratio to the focal length matters


class SceneError(Exception):
    """A mistake of the user's scene: what, where, expected, do."""


def refuse_without_numpy() -> None:
    """Debian's package only recommends NumPy, which the proxy and Blender's own importers need."""
    if importlib.util.find_spec("numpy") is None:
        raise SceneError(
            "This Blender's Python has no NumPy", bpy.app.binary_path, "a Blender with NumPy, as blender.org builds it",
            "install python3-numpy (Debian), or use a build of blender.org",
        )  # fmt: skip


def open_scene(request: dict[str, Any]) -> None:
    """Opens the file of a request and sets what every picture shares."""
    path = request["scene"]
    if path.endswith(".blend"):
        bpy.ops.wm.open_mainfile(filepath=path, use_scripts=False, load_ui=False)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        versions.import_gltf(path)
        _world(request.get("world"))
    _refuse(path)
    _settings(request.get("threads", 1), request.get("seed", 0))


def facts() -> dict[str, Any]:
    """Files outside the scene file that it is made from, its colour space, and whether this Blender denoises."""
    listed = {os.path.realpath(bpy.path.abspath(p)) for p in bpy.utils.blend_paths(absolute=True, packed=False)}
    return {
        "files": sorted(path for path in listed if Path(path).is_file()),
        "working_space": versions.working_space(),
        "denoises": versions.denoises(),
        "version": list(bpy.app.version),
    }


def camera(described: dict[str, Any]) -> None:
    """The shot's camera: a pinhole with square or oblong pixels and any principal point."""
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("yesnt camera")
    made = bpy.data.objects.new("yesnt camera", lens)
    scene.collection.objects.link(made)
    width, height, fx, fy = (described[name] for name in ("width", "height", "fx", "fy"))
    tall = fx / fy  # height of a pixel over its width
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / tall), max(1.0, tall)
    lens.type, lens.sensor_fit, lens.sensor_width, lens.lens = "PERSP", "HORIZONTAL", _SENSOR, fx * _SENSOR / width
    lens.shift_x = (width / 2 - described["cx"]) / width
    lens.shift_y = (described["cy"] - height / 2) * tall / width
    lens.clip_start, lens.clip_end = 0.01, 1e5
    made.matrix_world = Matrix(described["scene_from_camera"]) @ _OPENCV_TO_BLENDER
    scene.camera = made


def _settings(threads: int, seed: int) -> None:
    """Cycles on the processor with fixed samples: the same picture each time. Bounces and clamps stay the scene's."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.threads_mode, render.threads = "FIXED", threads
    render.use_persistent_data = True
    render.use_motion_blur = render.use_border = render.use_multiview = False
    render.film_transparent = False
    cycles.device, cycles.seed, cycles.use_animated_seed, cycles.use_adaptive_sampling = "CPU", seed, False, False
    cycles.use_auto_tile = False
    versions.without_compositing(scene)
    versions.multilayer_exr(scene)
    layer = versions.single_layer(scene)
    layer.samples = 0
    layer.use_pass_combined = layer.use_pass_z = True
    layer.use_pass_glossy_direct = layer.use_pass_glossy_indirect = layer.use_pass_glossy_color = True


def _world(described: dict[str, Any] | None) -> None:
    """A glTF scene has no world: the job's light, as a lat-long map in Blender's convention, or black."""
    world = bpy.data.worlds.new("yesnt world")
    bpy.context.scene.world = world
    tree = versions.use_nodes(world)
    tree.nodes.clear()
    background, out = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    tree.links.new(background.outputs["Background"], out.inputs["Surface"])
    if described is None:
        return
    texture, turn = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeMapping")
    place = tree.nodes.new("ShaderNodeTexCoord")
    texture.image = bpy.data.images.load(described["path"])
    versions.linear_rec709(texture.image)
    turn.inputs["Rotation"].default_value = (0.0, 0.0, -math.radians(described["yaw"]))
    tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])


def _refuse(path: str) -> None:
    """Refuses what would give a plausible wrong picture: absent files, another unit, a special scene."""
    absent = sorted(
        {bpy.path.abspath(i.filepath) for i in bpy.data.images if i.source == "FILE" and _is_absent(i)}
        | {bpy.path.abspath(one.filepath) for one in bpy.data.libraries if not _exists(one.filepath)}
    )
    if absent:
        raise SceneError(
            f"The scene uses files that are not there: {', '.join(absent)}", path, "every picture and library",
            "put them there, or pack them into the file (File > External Data)",
        )  # fmt: skip
    scale = bpy.context.scene.unit_settings.scale_length
    if bpy.context.scene.unit_settings.system != "NONE" and abs(scale - 1) > 1e-6:
        raise SceneError(
            f"The scene's unit scale is {scale:g}", path, "one Blender unit to the metre (unit scale 1)",
            "set Scene > Units > Unit Scale to 1 and scale the scene",
        )  # fmt: skip


def _is_absent(image: Any) -> bool:
    return bool(image.users and image.packed_file is None and image.filepath and not _exists(image.filepath))


def _exists(path: str) -> bool:
    absolute = bpy.path.abspath(path)
    return Path(absolute).is_file() or "<UDIM>" in absolute
