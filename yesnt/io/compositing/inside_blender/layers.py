"""Builds a compositor that puts the layers of an EXR sequence of yesnt together. Blender 3.4 to 5.x.

In Blender: open it in the text editor and press Run. Or:

    blender --background --python NAME_layers.py -- composite.blend

which writes the file that it is given. The sequence must lie in the script's folder.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import bpy

NAME = "shot"
FRAMES = (1001, 1002)
SIZE = (1920, 1080)
ASPECT = 1.0
FRONT = True
SET = True
GROUPS = False

FOLDER = os.path.dirname(os.path.abspath(__file__))


def main() -> None:
    """Sets the scene's size and frames, builds the nodes, and saves a file if one is named."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = FRAMES
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = *SIZE, 100
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, ASPECT), max(1.0, 1 / ASPECT)
    render.use_compositing, render.use_sequencer = True, False
    scene.view_settings.view_transform = "Standard"
    build(tree_of(scene))
    if "--" in sys.argv and len(sys.argv) > sys.argv.index("--") + 1:
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(sys.argv[-1]))


def tree_of(scene: Any) -> Any:
    """The scene's empty compositor; from 5.0 on, a node group of its own."""
    if hasattr(scene, "compositing_node_group"):
        tree = bpy.data.node_groups.new(f"{NAME} layers", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        scene.compositing_node_group = tree
        return tree
    scene.use_nodes = True
    scene.node_tree.nodes.clear()
    return scene.node_tree


def build(tree: Any) -> None:
    """The composite of the layers, with light groups by two factors, `sun` and `rest`, which are 1."""
    layers = source(tree)
    made = of_set(tree, layers) if SET else layers["Image" if "Image" in layers else "Combined"]
    output(tree, rebalanced(tree, made, layers) if GROUPS else made)


def of_set(tree: Any, layers: dict[str, Any]) -> Any:
    """What is in front of the subject, over the subject, over max(env shadow_set + reflection_set, 0)."""
    shadow = math(tree, "MAXIMUM", layers["shadow_set"], 0.0, "shadow_set")
    dimmed = mix(tree, "MULTIPLY", opaque(tree, layers["env"], 1.0), shadow, "in shadow")
    behind = clipped(tree, mix(tree, "ADD", dimmed, layers["reflection_set"], "behind"))
    clear = math(tree, "SUBTRACT", 1.0, layers["holdout"], "not held out")
    if not FRONT:
        return over(tree, opaque(tree, behind, 1.0), scaled(tree, layers["relit"], clear), "composite")
    covered = over(tree, opaque(tree, behind, 1.0), layers["relit"], "subject")
    held = mix(tree, "MULTIPLY", covered, clear, "held out")
    total = mix(tree, "ADD", held, layers["front"], "composite")
    return with_alpha(tree, total, over_alpha(tree, covered, clear, layers["holdout"]))


def rebalanced(tree: Any, composite: Any, layers: dict[str, Any]) -> Any:
    """The composite, and of each light group what its factor is above 1."""
    for name in ("sun", "rest"):
        more = math(tree, "SUBTRACT", value(tree, 1.0, name), 1.0, f"more {name}")
        composite = mix(tree, "ADD", composite, scaled(tree, layers[f"light_{name}"], more), f"with {name}")
    return composite


def source(tree: Any) -> dict[str, Any]:
    """The sequence, and its layers by name."""
    image = bpy.data.images.load(os.path.join(FOLDER, f"{NAME}.{FRAMES[0]:04d}.exr"))
    image.source = "SEQUENCE"
    names = [item.identifier for item in type(image.colorspace_settings).bl_rna.properties["name"].enum_items]
    image.colorspace_settings.name = next(n for n in ("Linear Rec.709", "Linear") if n in names)
    node = tree.nodes.new("CompositorNodeImage")
    node.image = image
    node.frame_start, node.frame_duration, node.frame_offset = FRAMES[0], FRAMES[1] - FRAMES[0] + 1, FRAMES[0] - 1
    return {socket.name.rpartition(".")[2]: socket for socket in node.outputs}


def new(tree: Any, kind: str, label: str = "") -> Any:
    """A node with a label."""
    node = tree.nodes.new(kind)
    node.label = label
    return node


def feed(tree: Any, socket: Any, value: Any) -> None:
    """Links a socket, or sets its value."""
    if isinstance(value, int | float):
        socket.default_value = value
    else:
        tree.links.new(value, socket)


def value(tree: Any, number: float, label: str) -> Any:
    """A number that the user changes."""
    node = new(tree, "ShaderNodeValue" if bpy.app.version >= (5, 0, 0) else "CompositorNodeValue", label)
    node.outputs[0].default_value = number
    return node.outputs[0]


def math(tree: Any, operation: str, a: Any, b: Any, label: str) -> Any:
    """A number of each pixel."""
    kind = "ShaderNodeMath" if bpy.app.version >= (5, 0, 0) else "CompositorNodeMath"
    node = new(tree, kind, label)
    node.operation = operation
    feed(tree, node.inputs[0], a)
    feed(tree, node.inputs[1], b)
    return node.outputs[0]


def mix(tree: Any, blend: str, a: Any, b: Any, label: str) -> Any:
    """A colour of each pixel; the alpha is that of `a`."""
    if bpy.app.version >= (5, 0, 0):
        node = new(tree, "ShaderNodeMix", label)
        node.data_type, node.blend_type, node.clamp_result = "RGBA", blend, False
        feed(tree, next(s for s in node.inputs if s.identifier == "Factor_Float"), 1.0)
        feed(tree, next(s for s in node.inputs if s.identifier == "A_Color"), a)
        feed(tree, next(s for s in node.inputs if s.identifier == "B_Color"), b)
        return next(s for s in node.outputs if s.identifier == "Result_Color")
    node = new(tree, "CompositorNodeMixRGB", label)
    node.blend_type = blend
    feed(tree, node.inputs[0], 1.0)
    feed(tree, node.inputs[1], a)
    feed(tree, node.inputs[2], b)
    return node.outputs[0]


def split(tree: Any, color: Any) -> Any:
    """The channels of a colour."""
    name = "CompositorNodeSeparateColor"
    node = new(tree, name)
    feed(tree, node.inputs[0], color)
    return node.outputs


def joined(tree: Any, *channels: Any) -> Any:
    """A colour of red, green, blue and alpha."""
    node = new(tree, "CompositorNodeCombineColor")
    for socket, value in zip(node.inputs, channels, strict=True):
        feed(tree, socket, value)
    return node.outputs[0]


def opaque(tree: Any, color: Any, alpha: float) -> Any:
    """A colour with one alpha."""
    red, green, blue, _ = split(tree, color)
    return joined(tree, red, green, blue, alpha)


def with_alpha(tree: Any, color: Any, alpha: Any) -> Any:
    """A colour with an alpha of its own."""
    red, green, blue, _ = split(tree, color)
    return joined(tree, red, green, blue, alpha)


def clipped(tree: Any, color: Any) -> Any:
    """A colour without negative values."""
    red, green, blue, alpha = split(tree, color)
    red, green, blue = (math(tree, "MAXIMUM", one, 0.0, "") for one in (red, green, blue))
    return joined(tree, red, green, blue, alpha)


def scaled(tree: Any, color: Any, factor: Any) -> Any:
    """A colour and its alpha, times a number of each pixel."""
    return joined(tree, *[math(tree, "MULTIPLY", one, factor, "") for one in split(tree, color)])


def over(tree: Any, below: Any, above: Any, label: str) -> Any:
    """Porter and Duff's over of associated colours."""
    node = new(tree, "CompositorNodeAlphaOver", label)
    images = [socket for socket in node.inputs if socket.type == "RGBA"]
    feed(tree, images[0], below)
    feed(tree, images[1], above)
    return node.outputs[0]


def over_alpha(tree: Any, covered: Any, clear: Any, holdout: Any) -> Any:
    """Alpha (1 - holdout) + holdout."""
    alpha = split(tree, covered)[3]
    return math(tree, "ADD", math(tree, "MULTIPLY", alpha, clear, ""), holdout, "alpha")


def output(tree: Any, color: Any) -> None:
    """What the compositor gives."""
    if bpy.app.version >= (5, 0, 0):
        feed(tree, new(tree, "NodeGroupOutput").inputs[0], color)
        return
    feed(tree, new(tree, "CompositorNodeComposite").inputs[0], color)


if __name__ == "__main__":
    main()
