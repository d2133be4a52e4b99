"""Puts a subject into Blender's scene: a painted, animated mesh from an archive, or a glTF model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bmesh  # type: ignore[import-not-found]
import bpy
import materials  # type: ignore[import-not-found]
import numpy as np

_HAIR_RADIUS = 0.0004  # metres: thicker than real hair, since there are fewer strands


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
    mesh.materials.append(materials.layered_material(subject["layers"], subject.get("subsurface", 0.0)))
    obj = bpy.data.objects.new("subject", mesh)
    bpy.context.scene.collection.objects.link(obj)
    if len(shapes) > 1:
        _animate(obj, shapes, frames)
    if subject["subdivision"]:
        smooth = obj.modifiers.new("smooth", "SUBSURF")
        smooth.levels = smooth.render_levels = subject["subdivision"]
    if strands is not None:
        _add_hair(strands)
    return [obj]


def _add_hair(strands: Any) -> None:
    """Adds curves [N, K, 3] in world metres; the proxy does not contain them."""
    curves = bpy.data.hair_curves.new("hair")
    curves.add_curves([strands.shape[1]] * len(strands))
    curves.attributes["position"].data.foreach_set("vector", np.ascontiguousarray(strands, np.float32).ravel())
    radius = curves.attributes.get("radius") or curves.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.full(strands.shape[0] * strands.shape[1], _HAIR_RADIUS, np.float32))
    curves.materials.append(materials.hair_material())
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("hair", curves))


def _attribute(mesh: Any, name: str, kind: str, slot: str, values: Any) -> None:
    made = mesh.attributes.new(name, kind, "POINT")
    made.data.foreach_set(slot, np.ascontiguousarray(values, dtype=np.float32).ravel())


def _animate(obj: Any, shapes: Any, frames: list[dict[str, Any]]) -> None:
    """One shape key a frame, at 1 on its frame and 0 on its neighbours."""
    obj.shape_key_add(name="Basis", from_mix=False)
    for frame in frames:
        key = obj.shape_key_add(name=str(frame["frame"]), from_mix=False)
        key.points.foreach_set("co", np.ascontiguousarray(shapes[frame["shape"]], dtype=np.float32).ravel())
        for offset, value in ((-1, 0.0), (1, 0.0), (0, 1.0)):
            key.value = value
            key.keyframe_insert("value", frame=frame["frame"] + offset)
    linear(obj.data.shape_keys)


def _add_projected(subject: dict[str, Any], frames: list[dict[str, Any]]) -> list[Any]:
    """A mesh in world space, coloured by a picture that is projected from the camera."""
    bpy.ops.wm.ply_import(filepath=subject["mesh"], forward_axis="Y", up_axis="Z")
    obj = bpy.context.selected_objects[0]
    obj.data.shade_smooth()
    obj.data.materials.clear()
    obj.data.materials.append(materials.projected_material(subject["image"], subject["roughness"]))
    return [obj]


def _add_gltf(subject: dict[str, Any], frames: list[dict[str, Any]]) -> list[Any]:
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=subject["path"])
    made = [obj for obj in bpy.data.objects if obj not in before]
    meshes = [obj for obj in made if obj.type == "MESH" and not _is_helper(obj)]
    for obj in made:
        if obj.type == "MESH" and obj not in meshes:
            bpy.data.objects.remove(obj)
    for material in bpy.data.materials:
        _prepare_material(material, subject["roughness"])
    if subject["smooth"]:
        for obj in meshes:
            _smooth(obj)
    _choose_action(subject)
    _place(meshes, subject, subject["start"])
    return meshes


def _is_helper(obj: Any) -> bool:
    """The importer's bone shapes are meshes too; they carry no material."""
    return not obj.data.materials


def _prepare_material(material: Any, roughness: list[float] | None) -> None:
    shaders = [n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"] if material.node_tree else []
    for shader in shaders:
        if roughness is not None:
            materials.vary_roughness(material.node_tree, shader, *roughness)
        materials.truth_outputs(material.node_tree, shader)


def _smooth(obj: Any) -> None:
    """Joins the vertices that flat shading had split, then rounds the facets; weights and UVs stay."""
    shell = bmesh.new()
    shell.from_mesh(obj.data)
    bmesh.ops.remove_doubles(shell, verts=shell.verts, dist=1e-4 * max(obj.dimensions))
    shell.to_mesh(obj.data)
    shell.free()
    obj.data.shade_smooth()
    obj.modifiers.new("smooth", "SUBSURF").render_levels = 2
    obj.modifiers["smooth"].levels = 1


def _choose_action(subject: dict[str, Any]) -> None:
    """Loops the named action from the set's first frame on; other actions and tracks are dropped."""
    name = subject.get("action")
    for rig in [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]:
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
    for obj in [t for t in bpy.data.objects if t.parent is None and t is not root]:
        obj.parent = root
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
    points = np.concatenate([world_mesh(obj)[0] for obj in meshes])
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max()), float(points[:, 2].min())


def world_mesh(obj: Any) -> tuple[Any, Any]:
    """Evaluated vertices [V, 3] in world metres and triangles [F, 3] of an object at the present frame."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(len(mesh.loop_triangles) * 3, dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    matrix = np.array(evaluated.matrix_world, dtype=np.float64)
    evaluated.to_mesh_clear()
    return vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3], triangles.reshape(-1, 3)


def joined(meshes: list[Any]) -> tuple[Any, Any]:
    """All meshes as one: vertices [V, 3] float32 in world metres, faces [F, 3] int32."""
    parts = [world_mesh(obj) for obj in meshes]
    starts = np.cumsum([0, *(len(v) for v, _ in parts[:-1])])
    vertices = np.concatenate([v for v, _ in parts])
    faces = np.concatenate([f + start for (_, f), start in zip(parts, starts, strict=True)])
    return vertices.astype("<f4"), faces.astype("<i4")


def decimated(meshes: list[Any], triangles: int) -> tuple[Any, Any]:
    """All meshes as one, brought down to about so many triangles: vertices [V, 3] float32, faces [F, 3] int32."""
    vertices, faces = joined(meshes)
    mesh = bpy.data.meshes.new("proxy")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    obj = bpy.data.objects.new("proxy", mesh)
    bpy.context.scene.collection.objects.link(obj)
    if len(faces) > triangles:
        obj.modifiers.new("fewer", "DECIMATE").ratio = triangles / len(faces)
    out_vertices, out_faces = world_mesh(obj)
    bpy.data.objects.remove(obj)
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
