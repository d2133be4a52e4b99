"""Everything in which Blender 3.4 to 5.x differ for this package."""

from __future__ import annotations

from typing import Any

import bpy


def multilayer_exr(scene: Any) -> None:
    """Output as multi-layer EXR of floats; from 5.0 on, the kind of picture is chosen first."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "ZIP"


def panorama(camera: Any) -> None:
    """Makes a camera a lat-long panorama; from 5.0 on, the setting is the camera's and not Cycles'."""
    camera.type = "PANO"
    owner = camera if hasattr(camera, "panorama_type") else camera.cycles
    owner.panorama_type = "EQUIRECTANGULAR"


def use_nodes(owner: Any) -> Any:
    """The node tree of a world or material; from 5.0 on, every one has nodes, and `use_nodes` warns."""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    return owner.node_tree


def without_compositing(scene: Any) -> None:
    """The plates are the renderer's own: neither compositor nor sequencer changes them."""
    scene.render.use_compositing = scene.render.use_sequencer = False


def working_space() -> str:
    """Blender's name of the space that it renders in; before 5.0 always linear Rec.709."""
    spaces = getattr(bpy.data, "colorspace", None)
    return "Linear Rec.709" if spaces is None else str(spaces.working_space)


def import_gltf(path: str) -> None:
    """Imports a glTF file; the importer of 3.4 uses an alias that NumPy 1.24 no longer has."""
    import numpy as np

    if not hasattr(np, "bool"):
        vars(np)["bool"] = bool
    bpy.ops.import_scene.gltf(filepath=path)


def denoises() -> bool:
    """Whether this Blender was built with Open Image Denoise; Debian's is not."""
    try:
        import _cycles  # type: ignore[import-not-found]
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))


def render_to(scene: Any, path: str) -> None:
    """Renders the scene to a file.

    Blender 5.0 cannot write a multi-layer EXR with oblong pixels (its parts contradict each other in the header), so
    the finished picture is saved as one of square pixels.
    """
    render = scene.render
    aspect = render.pixel_aspect_x, render.pixel_aspect_y
    if bpy.app.version < (5, 0, 0) or aspect == (1, 1):
        render.filepath = path
        bpy.ops.render.render(write_still=True)
        return
    bpy.ops.render.render(write_still=False)
    render.pixel_aspect_x = render.pixel_aspect_y = 1
    bpy.data.images["Render Result"].save_render(path, scene=scene)
    render.pixel_aspect_x, render.pixel_aspect_y = aspect


def single_layer(scene: Any) -> Any:
    """Leaves one view layer to be rendered: the first that the scene renders."""
    layer = next((one for one in scene.view_layers if one.use), scene.view_layers[0])
    for other in scene.view_layers:
        other.use = other == layer
    return layer


def linear_rec709(image: Any) -> None:
    """Says that a picture holds scene-linear Rec.709; before 4.0 the space had another name."""
    names = [item.identifier for item in type(image.colorspace_settings).bl_rna.properties["name"].enum_items]
    image.colorspace_settings.name = next(n for n in ("Linear Rec.709", "Linear", "Linear BT.709") if n in names)


def emit(shader: Any, strength: float) -> None:
    """Makes a Principled BSDF emit white light; its colour input was renamed in 4.0."""
    color = shader.inputs.get("Emission Color") or shader.inputs["Emission"]
    color.default_value, shader.inputs["Emission Strength"].default_value = (1.0, 1.0, 1.0, 1.0), strength
