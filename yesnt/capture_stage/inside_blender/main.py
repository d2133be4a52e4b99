"""Renders the pictures of one request: `python main.py request.json`, or `blender -b --python main.py -- request.json`.

Writes raw multi-layer EXRs under temporary names and renames them when whole; the host turns them into a shot.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
import materials  # type: ignore[import-not-found]
import subjects  # type: ignore[import-not-found]
from mathutils import Matrix

_PIXEL_FILTER_WIDTH = 1.5  # pixels: Cycles' own default, an antialiased picture
_POINT_FILTER_WIDTH = 0.01  # pixels: geometry is read at pixel centres
_LIT_BY = "lit by"
_DELIVERED, _OF_RIG = "delivered camera", "camera of the rig"
_OPENCV_TO_BLENDER = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))


def main() -> None:
    """Reads the request, builds the scene once, renders the images; writes one JSON line of progress per image."""
    request = json.loads(Path(sys.argv[-1]).read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _scene(request)
    meshes = subjects.add_subject(request["subject"], request["frames"])
    _camera(request)
    for render in request["renders"]:
        start = time.perf_counter()
        bpy.context.scene.frame_set(render["frame"])
        _choose_camera(render.get("world_from_camera"))
        _RENDERERS[render["what"]](render, request, meshes)
        sys.stdout.write(f"\nyesnt {json.dumps({'out': render['out'], 'seconds': time.perf_counter() - start})}\n")
        sys.stdout.flush()


def _scene(request: dict[str, Any]) -> None:
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = request["width"], request["height"]
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = True
    scene.render.use_persistent_data = True
    scene.render.threads_mode, scene.render.threads = "FIXED", request["threads"]
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    cycles = scene.cycles
    cycles.device, cycles.seed, cycles.use_adaptive_sampling = "CPU", 0, False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0  # truth is not clamped
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = True
    layer.use_pass_vector = request["truth"]
    for name, kind in materials.AOVS if request["truth"] else ():
        aov = layer.aovs.add()
        aov.name, aov.type = name, kind
    scene.world = bpy.data.worlds.new("light")
    scene.world.use_nodes = True


def _camera(request: dict[str, Any]) -> None:
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("lens")
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", 36.0
    lens.lens = request["fx"] * 36.0 / request["width"]
    lens.clip_start, lens.clip_end = 0.01, 1000.0
    for name in (_DELIVERED, _OF_RIG):
        scene.collection.objects.link(bpy.data.objects.new(name, lens))
    camera = scene.objects[_DELIVERED]
    camera.rotation_mode = "QUATERNION"
    for frame in request["frames"]:
        camera.matrix_world = Matrix(frame["world_from_camera"]) @ _OPENCV_TO_BLENDER
        camera.keyframe_insert("location", frame=frame["frame"])
        camera.keyframe_insert("rotation_quaternion", frame=frame["frame"])
    subjects.linear(camera)


def _choose_camera(pose: list[list[float]] | None) -> None:
    """Looks through the delivered camera, or through one of a rig that stands so."""
    scene = bpy.context.scene
    scene.camera = scene.objects[_DELIVERED if pose is None else _OF_RIG]
    if pose is not None:
        scene.camera.matrix_world = Matrix(pose) @ _OPENCV_TO_BLENDER


def _light(path: str) -> None:
    """Lights the scene by a map; one that it is lit by already stays, since Cycles prepares a map for two seconds."""
    world = bpy.context.scene.world
    if world.get(_LIT_BY) == path:
        return
    world[_LIT_BY] = path
    tree = world.node_tree
    tree.nodes.clear()
    texture, background = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeBackground")
    texture.image = bpy.data.images.load(path, check_existing=True)
    texture.image.colorspace_settings.name = "Linear Rec.709"
    out = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], out.inputs["Surface"])


def _bounces(number: int | None) -> None:
    """Ends paths after so many bounces; None: Cycles' own defaults."""
    cycles = bpy.context.scene.cycles
    for name in ("max_bounces", "diffuse_bounces", "glossy_bounces"):
        if number is None:
            cycles.property_unset(name)
        else:
            setattr(cycles, name, number)


def _render(out: str, samples: int, filter_width: float, denoise: bool) -> None:
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.use_denoising = samples, denoise
    scene.cycles.filter_width = filter_width
    temporary = f"{out}.{os.getpid()}.exr"
    scene.render.filepath = temporary
    bpy.ops.render.render(write_still=True)
    os.replace(temporary, out)


def _render_light(render: dict[str, Any], request: dict[str, Any], meshes: list[Any]) -> None:
    _light(render["env"])
    _bounces(render.get("bounces"))
    _render(render["out"], request["samples"], _PIXEL_FILTER_WIDTH, request["samples"] > 1)


def _render_geometry(render: dict[str, Any], request: dict[str, Any], meshes: list[Any]) -> None:
    _render(render["out"], 1, _POINT_FILTER_WIDTH, denoise=False)


def _write_proxy(render: dict[str, Any], request: dict[str, Any], meshes: list[Any]) -> None:
    temporary = Path(f"{render['out']}.{os.getpid()}")
    subjects.write_ply(temporary, *subjects.decimated(meshes, request["proxy_triangles"]))
    os.replace(temporary, render["out"])


def _write_mesh(render: dict[str, Any], request: dict[str, Any], meshes: list[Any]) -> None:
    """The surface as it is rendered: modifiers as in a render, nothing decimated."""
    for modifier in (m for obj in meshes for m in obj.modifiers if m.type == "SUBSURF"):
        modifier.levels = modifier.render_levels
    temporary = Path(f"{render['out']}.{os.getpid()}")
    subjects.write_ply(temporary, *subjects.joined(meshes))
    os.replace(temporary, render["out"])


_RENDERERS = {"light": _render_light, "geometry": _render_geometry, "proxy": _write_proxy, "mesh": _write_mesh}

if __name__ == "__main__":
    main()
