"""Exports the camera of a Blender scene, and on request proxy meshes, for yesnt. Blender 3.4 to 5.x.

In Blender: paste it into the text editor, save the scene, press Run; camera.json appears beside the scene. Or:

    blender scene.blend --background --python export_camera.py -- --out FOLDER --proxy COLLECTION --frames 1001-1010

Render with the same resolution. Lengths are Blender's units, in which its depth pass is too.
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import sys
from collections.abc import Callable
from typing import Any


def lens_of(camera: Any, render: Any) -> dict[str, Any]:
    """Width, height, fx, fy, cx, cy in pixels of a perspective camera; principal point from the upper left corner."""
    if camera.type != "PERSP":
        raise SystemExit(f"yesnt: the camera is {camera.type}; expected a perspective camera")
    if render.use_border and render.use_crop_to_border:
        raise SystemExit("yesnt: the render region is cropped; switch Crop to Render Region off")
    width = int(render.resolution_x * render.resolution_percentage / 100)
    height = int(render.resolution_y * render.resolution_percentage / 100)
    tall = render.pixel_aspect_y / render.pixel_aspect_x  # height of a pixel over its width
    wide = width >= height * tall if camera.sensor_fit == "AUTO" else camera.sensor_fit == "HORIZONTAL"
    across = width if wide else height * tall  # pixel widths that the sensor's side spans
    side = camera.sensor_height if camera.sensor_fit == "VERTICAL" else camera.sensor_width
    focal = camera.lens / side * across
    cx, cy = width / 2 - camera.shift_x * across, height / 2 + camera.shift_y * across / tall
    return {"width": width, "height": height, "fx": focal, "fy": focal / tall, "cx": cx, "cy": cy}


def pose_of(matrix: Any) -> list[float]:
    """`world_from_camera`, 16 numbers row-major, of a world matrix without its scale."""
    place, rotation, _ = matrix.decompose()
    turned = rotation.to_matrix()
    rows = [[*turned[i], place[i]] for i in range(3)]
    return [float(value) for row in (*rows, [0, 0, 0, 1]) for value in row]


def camera_document(scene: Any, depsgraph_of: Callable[[], Any], frames: list[int]) -> dict[str, Any]:
    """camera.json of frames; what changes from frame to frame stands there."""
    if scene.camera is None:
        raise SystemExit("yesnt: the scene has no active camera")
    lenses, poses = {}, {}
    for frame in frames:
        scene.frame_set(frame)
        seen = scene.camera.evaluated_get(depsgraph_of())
        lenses[frame], poses[frame] = lens_of(seen.data, scene.render), pose_of(seen.matrix_world)
    first = lenses[frames[0]]
    document: dict[str, Any] = {"axes": "blender", "units": "m", "name": scene.camera.name, **first, "frames": {}}
    for frame in frames:
        own = {key: value for key, value in lenses[frame].items() if value != first[key]}
        if "width" in own or "height" in own:
            raise SystemExit(f"yesnt: the resolution changes at frame {frame}")
        document["frames"][str(frame)] = {"world_from_camera": poses[frame], **own}
    return document


def write_proxy(path: str, chosen: set[Any], depsgraph: Any) -> None:
    """All triangles of objects, instances included, as a binary PLY in world coordinates."""
    corners: list[tuple[float, ...]] = []
    triangles: list[tuple[int, ...]] = []
    for instance in depsgraph.object_instances:
        source = instance.parent if instance.is_instance else instance.object
        if source.original not in chosen or instance.object.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"}:
            continue
        mesh = instance.object.to_mesh()
        mesh.calc_loop_triangles()
        first = len(corners)
        corners += [tuple(instance.matrix_world @ vertex.co) for vertex in mesh.vertices]
        triangles += [tuple(first + index for index in face.vertices) for face in mesh.loop_triangles]
        instance.object.to_mesh_clear()
    if not triangles:
        raise SystemExit(f"yesnt: nothing to write to {path}: the collection has no visible surfaces")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(corners)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    with open(path, "wb") as target:
        target.write("\n".join(header).encode())
        target.write(b"".join(struct.pack("<3f", *corner) for corner in corners))
        target.write(b"".join(struct.pack("<B3i", 3, *triangle) for triangle in triangles))


def frames_of(text: str, scene: Any) -> list[int]:
    """Frame numbers of `1001-1010,1020`; without a text those of the scene."""
    if not text:
        return list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    ends = [part.rpartition("-") for part in text.split(",")]
    return sorted({frame for first, _, last in ends for frame in range(int(first or last), int(last) + 1)})


def main(arguments: list[str]) -> None:
    """Writes camera.json, and proxy.####.ply for a named collection."""
    import bpy

    scene = bpy.context.scene
    parser = argparse.ArgumentParser(prog="export_camera.py")
    parser.add_argument("--out", default=bpy.path.abspath("//") or ".", help="folder; default: beside the scene")
    parser.add_argument("--frames", default="", help="as 1001-1010,1020; default: those of the scene")
    parser.add_argument("--proxy", default="", metavar="COLLECTION", help="also write its meshes as proxy.####.ply")
    asked = parser.parse_args(arguments)
    frames, before = frames_of(asked.frames, scene), scene.frame_current
    document = camera_document(scene, bpy.context.evaluated_depsgraph_get, frames)
    document["source"] = f"Blender {bpy.app.version_string}, {os.path.basename(bpy.data.filepath) or 'unsaved scene'}"
    os.makedirs(asked.out, exist_ok=True)
    with open(os.path.join(asked.out, "camera.json"), "w", encoding="utf-8") as target:
        json.dump(document, target, indent=1)
    if asked.proxy:
        if asked.proxy not in bpy.data.collections:
            raise SystemExit(f"yesnt: no collection {asked.proxy!r}; there are {sorted(bpy.data.collections.keys())}")
        chosen = set(bpy.data.collections[asked.proxy].all_objects)
        for frame in frames:
            scene.frame_set(frame)
            path = os.path.join(asked.out, f"proxy.{frame:04d}.ply")
            write_proxy(path, chosen, bpy.context.evaluated_depsgraph_get())
    scene.frame_set(before)


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
