"""Puts a subject into Blender's scene: a painted, animated mesh from an archive, or a glTF model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bmesh  # type: ignore[import-not-found]
import bpy
import coats  # type: ignore[import-not-found]
import numpy as np

_HAIR_RADIUS = 0.0004  # metres: thicker than a hair, since there are fewer


def add_subject(subject: dict[str, Any], frames: list[dict[str, Any]]) -> list[Any]:
    """Adds what the request describes; returns its mesh objects."""
    makers = {"mesh": _add_archive, "gltf": _add_gltf, "projected": _add_projected}
    return makers[subject["kind"]](subject, frames)


def linear(owner: Any) -> None:
    """Makes every key of an animated block linear, so that whole frames are exact and motion vectors are straight."""
    for curve in _curves(owner.animation_data.action):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def _curves(action: Any) -> list[Any]:
    if hasattr(action, "fcurves"):  # before Blender 5.0
        return list(action.fcurves)
    return [
        curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves
    ]


def _add_archive(subject: dict[str, Any], frames: list[dict[str, Any]]) -> list[Any]:
    with np.load(subject["archive"]) as data:
        shapes, faces, rest = data["vertices"], data["faces"], data["rest"]
        fields = {name.removeprefix("field_"): data[name] for name in data.files if name.startswith("field_")}
        strands = data["strands"] if "strands" in data.files else None
    mesh = bpy.data.meshes.new("subject")
    mesh.from_pydata(shapes[0].tolist(), [], faces.tolist())
    mesh.shade_smooth()
    _attribute(mesh, "rest", "FLOAT_VECTOR", "vector", rest)
    for name, values in fields.items():
        _attribute(mesh, f"field_{name}", "FLOAT", "value", values)
    mesh.materials.append(coats.coat_material(subject["coat"], subject.get("flesh", 0.0)))
    thing = bpy.data.objects.new("subject", mesh)
    bpy.context.scene.collection.objects.link(thing)
    if len(shapes) > 1:
        _animate(thing, shapes, frames)
    if subject["subdivision"]:
        smooth = thing.modifiers.new("smooth", "SUBSURF")
        smooth.levels = smooth.render_levels = subject["subdivision"]
    if strands is not None:
        _add_hair(strands)
    return [thing]


def _add_hair(strands: Any) -> None:
    """Curves [N, K, 3] in world metres; they are no part of the proxy."""
    curves = bpy.data.hair_curves.new("hair")
    curves.add_curves([strands.shape[1]] * len(strands))
    curves.attributes["position"].data.foreach_set("vector", np.ascontiguousarray(strands, np.float32).ravel())
    radius = curves.attributes.get("radius") or curves.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.full(strands.shape[0] * strands.shape[1], _HAIR_RADIUS, np.float32))
    curves.materials.append(coats.hair_material())
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("hair", curves))


def _attribute(mesh: Any, name: str, kind: str, slot: str, values: Any) -> None:
    made = mesh.attributes.new(name, kind, "POINT")
    made.data.foreach_set(slot, np.ascontiguousarray(values, dtype=np.float32).ravel())


def _animate(thing: Any, shapes: Any, frames: list[dict[str, Any]]) -> None:
    """One shape key a frame, at 1 on its frame and 0 on its neighbours."""
    thing.shape_key_add(name="Basis", from_mix=False)
    for frame in frames:
        key = thing.shape_key_add(name=str(frame["frame"]), from_mix=False)
        key.points.foreach_set("co", np.ascontiguousarray(shapes[frame["shape"]], dtype=np.float32).ravel())
        for offset, value in ((-1, 0.0), (1, 0.0), (0, 1.0)):
            key.value = value
            key.keyframe_insert("value", frame=frame["frame"] + offset)
    linear(thing.data.shape_keys)


def _add_projected(subject: dict[str, Any], frames: list[dict[str, Any]]) -> list[Any]:
    """A mesh in world space, coloured by a picture that is projected from the camera."""
    bpy.ops.wm.ply_import(filepath=subject["mesh"], forward_axis="Y", up_axis="Z")
    thing = bpy.context.selected_objects[0]
    thing.data.shade_smooth()
    thing.data.materials.clear()
    thing.data.materials.append(coats.projected_material(subject["image"], subject["roughness"]))
    return [thing]


def _add_gltf(subject: dict[str, Any], frames: list[dict[str, Any]]) -> list[Any]:
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=subject["path"])
    made = [thing for thing in bpy.data.objects if thing not in before]
    meshes = [thing for thing in made if thing.type == "MESH" and not _is_helper(thing)]
    for thing in made:
        if thing.type == "MESH" and thing not in meshes:
            bpy.data.objects.remove(thing)
    for material in bpy.data.materials:
        _prepare_material(material, subject["roughness"])
    if subject["smooth"]:
        for thing in meshes:
            _smooth(thing)
    _choose_action(subject)
    _place(meshes, subject, subject["start"])
    return meshes


def _is_helper(thing: Any) -> bool:
    """The importer's bone shapes are meshes too; they carry no material."""
    return not thing.data.materials


def _prepare_material(material: Any, roughness: list[float] | None) -> None:
    shaders = [n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"] if material.node_tree else []
    for shader in shaders:
        if roughness is not None:
            coats.mottle(material.node_tree, shader, *roughness)
        coats.truth_outputs(material.node_tree, shader)


def _smooth(thing: Any) -> None:
    """Joins the vertices that flat shading had split, then rounds the facets; weights and UVs stay."""
    shell = bmesh.new()
    shell.from_mesh(thing.data)
    bmesh.ops.remove_doubles(shell, verts=shell.verts, dist=1e-4 * max(thing.dimensions))
    shell.to_mesh(thing.data)
    shell.free()
    thing.data.shade_smooth()
    thing.modifiers.new("smooth", "SUBSURF").render_levels = 2
    thing.modifiers["smooth"].levels = 1


def _choose_action(subject: dict[str, Any]) -> None:
    """Loops the named action from the set's first frame on; other actions and tracks are dropped."""
    name = subject.get("action")
    for rig in [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]:
        found = [action for action in bpy.data.actions if name and action.name.startswith(name)]
        rig.animation_data_clear()
        if not found:
            continue
        data = rig.animation_data_create()
        data.action = found[0]
        if hasattr(data, "action_slot") and data.action_slot is None and found[0].slots:
            data.action_slot = found[0].slots[0]
        shift = subject["start"] - found[0].frame_range[0]
        for curve in _curves(found[0]):
            for key in curve.keyframe_points:
                key.co.x += shift
                key.handle_left.x += shift
                key.handle_right.x += shift
            curve.modifiers.new("CYCLES")


def _place(meshes: list[Any], subject: dict[str, Any], frame: int) -> None:
    """Turns and scales the model as it is on the first frame; stands it on z = 0, or hangs it at a height."""
    bpy.context.scene.frame_set(frame)
    root = bpy.data.objects.new("stand", None)
    bpy.context.scene.collection.objects.link(root)
    for thing in [t for t in bpy.data.objects if t.parent is None and t is not root]:
        thing.parent = root
    root.rotation_euler = subject["turn"]
    bpy.context.view_layer.update()
    center, radius, _ = _extent(meshes)
    root.scale = (subject["size"] / (2 * radius),) * 3
    bpy.context.view_layer.update()
    center, _, floor = _extent(meshes)
    height = -floor if subject["hang"] is None else subject["hang"] - center[2]
    root.location = (-center[0], -center[1], height)
    bpy.context.view_layer.update()


def _extent(meshes: list[Any]) -> tuple[Any, float, float]:
    """Middle of the bounding box, radius of the ball about it, lowest z; evaluated, in world space."""
    points = np.concatenate([world_mesh(thing)[0] for thing in meshes])
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max()), float(points[:, 2].min())


def world_mesh(thing: Any) -> tuple[Any, Any]:
    """Evaluated vertices [V, 3] in world metres and triangles [F, 3] of an object at the present frame."""
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(len(mesh.loop_triangles) * 3, dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    matrix = np.array(evaluated.matrix_world, dtype=np.float64)
    evaluated.to_mesh_clear()
    return vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3], triangles.reshape(-1, 3)


def decimated(meshes: list[Any], triangles: int) -> tuple[Any, Any]:
    """All meshes as one, brought down to about so many triangles: vertices [V, 3] float32, faces [F, 3] int32."""
    parts = [world_mesh(thing) for thing in meshes]
    starts = np.cumsum([0, *(len(v) for v, _ in parts[:-1])])
    vertices = np.concatenate([v for v, _ in parts])
    faces = np.concatenate([f + start for (_, f), start in zip(parts, starts, strict=True)])
    mesh = bpy.data.meshes.new("proxy")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    thing = bpy.data.objects.new("proxy", mesh)
    bpy.context.scene.collection.objects.link(thing)
    if len(faces) > triangles:
        thing.modifiers.new("fewer", "DECIMATE").ratio = triangles / len(faces)
    out_vertices, out_faces = world_mesh(thing)
    bpy.data.objects.remove(thing)
    bpy.data.meshes.remove(mesh)
    return out_vertices.astype("<f4"), out_faces.astype("<i4")


def write_ply(path: Path, vertices: Any, faces: Any) -> None:
    """Binary little-endian PLY, positions only."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    path.write_bytes(header.encode() + vertices.tobytes() + rows.tobytes())
