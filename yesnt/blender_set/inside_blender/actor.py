"""The proxy mesh of a frame in the scene: it casts shadows and is reflected, and the camera does not see it."""

from __future__ import annotations

from typing import Any

import bpy
import versions  # type: ignore[import-not-found]
from mathutils import Matrix

_SCALARS = ("roughness", "metallic")


def add(described: dict[str, Any]) -> Any:
    """Adds the mesh of an archive (`vertices`, `faces`, `base_color`, `roughness`, `metallic` at the vertices)."""
    import numpy as np

    with np.load(described["archive"]) as data:
        arrays = {name: data[name] for name in data.files}
    mesh = bpy.data.meshes.new("yesnt proxy")
    mesh.from_pydata(arrays["vertices"].tolist(), [], arrays["faces"].tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
    _attribute(mesh, "base_color", "FLOAT_VECTOR", "vector", arrays["base_color"])
    for name in _SCALARS:
        _attribute(mesh, name, "FLOAT", "value", arrays[name])
    mesh.materials.append(_material(described.get("emission", 0.0)))
    proxy = bpy.data.objects.new("yesnt proxy", mesh)
    proxy.matrix_world = Matrix(described["scene_from_world"])
    bpy.context.scene.collection.objects.link(proxy)
    proxy.visible_camera = False  # of the object, so that its materials stay what they are in every reflection
    return proxy


def _attribute(mesh: Any, name: str, kind: str, slot: str, values: Any) -> None:
    import numpy as np

    made = mesh.attributes.new(name, kind, "POINT")
    made.data.foreach_set(slot, np.ascontiguousarray(values, dtype=np.float32).ravel())


def _material(emission: float) -> Any:
    """Principled BSDF of the vertices' materials; `emission` only for tests of what the camera sees."""
    material = bpy.data.materials.new("yesnt proxy")
    tree = versions.use_nodes(material)
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    sockets = (
        ("base_color", "Vector", "Base Color"),
        ("roughness", "Fac", "Roughness"),
        ("metallic", "Fac", "Metallic"),
    )
    for name, output, socket in sockets:
        read = tree.nodes.new("ShaderNodeAttribute")
        read.attribute_name = name
        tree.links.new(read.outputs[output], shader.inputs[socket])
    if emission:
        versions.emit(shader, emission)
    return material
