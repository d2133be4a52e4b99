"""Shader nodes: layered materials and their true values as AOVs (base colour, roughness, metallic)."""

from __future__ import annotations

from typing import Any

import bpy

AOVS = (("base_color", "COLOR"), ("roughness", "VALUE"), ("metallic", "VALUE"))
_INPUTS = {"base_color": "Base Color", "roughness": "Roughness", "metallic": "Metallic"}
_IOR = 1.5


class Nodes:
    """A node tree with short methods for the nodes of layered materials; sockets in, sockets out."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def node(self, kind: str, **settings: Any) -> Any:
        """A new node with its properties set."""
        made = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(made, name, value)
        return made

    def feed(self, socket: Any, value: Any) -> None:
        """Links a socket, or sets a constant."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, (tuple, list)) and len(value) == 3 and socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def math(self, operation: str, a: Any, b: Any = 0.0) -> Any:
        """A scalar operation."""
        made = self.node("ShaderNodeMath", operation=operation)
        self.feed(made.inputs[0], a)
        self.feed(made.inputs[1], b)
        return made.outputs[0]

    def spread(self, value: Any, low: float, high: float, source: tuple[float, float] = (0.0, 1.0)) -> Any:
        """Maps `source` to low..high linearly, clamped."""
        made = self.node("ShaderNodeMapRange", clamp=True)
        for index, number in enumerate((value, *source, low, high)):
            self.feed(made.inputs[index], number)
        return made.outputs[0]

    def mix(self, share: Any, a: Any, b: Any, data_type: str) -> Any:
        """A at share 0, b at share 1; data_type "RGBA" or "FLOAT"."""
        made = self.node("ShaderNodeMix", data_type=data_type)
        offset = {"FLOAT": (2, 3, 0), "RGBA": (6, 7, 2)}[data_type]
        self.feed(made.inputs[0], share)
        self.feed(made.inputs[offset[0]], a)
        self.feed(made.inputs[offset[1]], b)
        return made.outputs[offset[2]]

    def field(self, name: str) -> Any:
        """A per-vertex number of the mesh."""
        return self.node("ShaderNodeAttribute", attribute_name=f"field_{name}").outputs["Fac"]

    def rest(self) -> Any:
        """Rest-pose position in metres: paint sticks to the surface when it moves."""
        return self.node("ShaderNodeAttribute", attribute_name="rest").outputs["Vector"]


def truth_outputs(tree: Any, shader: Any) -> None:
    """Copies what feeds a Principled BSDF into AOV outputs, and makes the BSDF no more than those three say."""
    for name, kind in AOVS:
        out = tree.nodes.new("ShaderNodeOutputAOV")
        out.aov_name = name
        source, target = shader.inputs[_INPUTS[name]], out.inputs["Color" if kind == "COLOR" else "Value"]
        if source.is_linked:
            tree.links.new(source.links[0].from_socket, target)
        else:
            target.default_value = source.default_value
    fixed = {"IOR": _IOR, "Specular IOR Level": 0.5, "Alpha": 1.0, "Emission Strength": 0.0}
    zero = (
        "Coat Weight",
        "Sheen Weight",
        "Subsurface Weight",
        "Transmission Weight",
        "Anisotropic",
        "Diffuse Roughness",
    )
    for name in (*fixed, *zero, "Specular Tint"):
        for link in list(shader.inputs[name].links):
            tree.links.remove(link)
    for name in (*fixed, *zero):
        shader.inputs[name].default_value = fixed.get(name, 0.0)
    shader.inputs["Specular Tint"].default_value = (1.0, 1.0, 1.0, 1.0)


def vary_roughness(tree: Any, shader: Any, low: float, high: float) -> None:
    """Replaces a shader's constant roughness by noise between two values, in coordinates of the rest shape."""
    nodes = Nodes(tree)
    noise = nodes.node("ShaderNodeTexNoise")
    nodes.feed(noise.inputs["Vector"], nodes.node("ShaderNodeTexCoord").outputs["Generated"])
    noise.inputs["Scale"].default_value = 9.0
    nodes.feed(shader.inputs["Roughness"], nodes.spread(noise.outputs[0], low, high, (0.35, 0.65)))


def projected_material(picture: str, roughness: float) -> Any:
    """A rough surface whose base colour is read from an image at the point's position on the screen."""
    material = bpy.data.materials.new("projected")
    material.use_nodes = True
    nodes = Nodes(material.node_tree)
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    image = nodes.node("ShaderNodeTexImage", image=bpy.data.images.load(picture), extension="EXTEND")
    image.image.colorspace_settings.name = "Linear Rec.709"
    nodes.feed(image.inputs["Vector"], nodes.node("ShaderNodeTexCoord").outputs["Window"])
    nodes.feed(shader.inputs["Base Color"], image.outputs["Color"])
    shader.inputs["Roughness"].default_value = roughness
    truth_outputs(material.node_tree, shader)
    return material


_SKIN_LAYERS = ("skin", "lips")
_MEAN_FREE_PATH = (3.67, 1.37, 0.68)  # millimetres in red, green, blue: skin of Jensen et al. 2001


def hair_material() -> Any:
    """Dark brown hair, its colour and roughness in the truth's outputs."""
    material = bpy.data.materials.new("hair")
    material.use_nodes = True
    nodes = Nodes(material.node_tree)
    out = next(n for n in material.node_tree.nodes if n.type == "OUTPUT_MATERIAL")
    shader = nodes.node("ShaderNodeBsdfHairPrincipled", parametrization="COLOR")
    shader.inputs["Color"].default_value = (0.10, 0.045, 0.02, 1.0)
    nodes.feed(out.inputs["Surface"], shader.outputs[0])
    for name, kind in AOVS:
        made = nodes.node("ShaderNodeOutputAOV", aov_name=name)
        value = {"base_color": (0.10, 0.045, 0.02, 1.0), "roughness": 0.3, "metallic": 0.0}[name]
        made.inputs["Color" if kind == "COLOR" else "Value"].default_value = value
    return material


def layered_material(layers: list[dict[str, Any]], subsurface: float = 0.0) -> Any:
    """One material of several layers: each covers those before it where its fields lie in its intervals.

    Args:
        layers: from the skin outwards.
        subsurface: weight of subsurface scattering in bare skin; 0 in all sets but `unmodelled`.
    """
    material = bpy.data.materials.new("layers")
    material.use_nodes = True
    nodes = Nodes(material.node_tree)
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    color, roughness, metallic = (0.5, 0.5, 0.5), 0.5, 0.0
    for layer in layers:
        mask = _mask(nodes, layer["where"])
        color = nodes.mix(mask, color, _color(nodes, layer), "RGBA")
        roughness = nodes.mix(mask, roughness, _roughness(nodes, layer), "FLOAT")
        metallic = nodes.mix(mask, metallic, layer["metallic"], "FLOAT")
    for name, value in zip(("Base Color", "Roughness", "Metallic"), (color, roughness, metallic), strict=True):
        nodes.feed(shader.inputs[name], value)
    truth_outputs(material.node_tree, shader)
    if subsurface:
        _add_subsurface(nodes, shader, layers, subsurface)
    return material


def _add_subsurface(nodes: Nodes, shader: Any, layers: list[dict[str, Any]], subsurface: float) -> None:
    """Gives the skin layers subsurface scattering."""
    weight: Any = 0.0
    for layer in layers:
        weight = nodes.mix(
            _mask(nodes, layer["where"]), weight, subsurface if layer["name"] in _SKIN_LAYERS else 0.0, "FLOAT"
        )
    nodes.feed(shader.inputs["Subsurface Weight"], weight)
    shader.inputs["Subsurface Radius"].default_value = _MEAN_FREE_PATH
    shader.inputs["Subsurface Scale"].default_value = 0.001


def _mask(nodes: Nodes, where: list[dict[str, Any]]) -> Any:
    mask: Any = 1.0
    for place in where:
        field = nodes.field(place["field"])
        for operation, bound in (("GREATER_THAN", place["low"]), ("LESS_THAN", place["high"])):
            if abs(bound) < 1e5:
                mask = nodes.math("MULTIPLY", mask, nodes.math(operation, field, bound))
    return mask


def _noise(nodes: Nodes, scale: float, detail: float = 3.0, stretch: tuple[float, float, float] | None = None) -> Any:
    where = nodes.rest()
    if stretch is not None:
        mapping = nodes.node("ShaderNodeMapping")
        nodes.feed(mapping.inputs["Vector"], where)
        mapping.inputs["Scale"].default_value = stretch
        where = mapping.outputs[0]
    noise = nodes.node("ShaderNodeTexNoise")
    nodes.feed(noise.inputs["Vector"], where)
    noise.inputs["Scale"].default_value = scale
    noise.inputs["Detail"].default_value = detail
    return nodes.spread(noise.outputs[0], 0.0, 1.0, (0.3, 0.7))  # "Fac" before 5.0, "Factor" or so after


def _bands(nodes: Nodes, scale: float, axis: str, sharpness: float = 0.15) -> Any:
    """Even stripes across an axis: a sine whose flanks are steepened, `scale` stripes a metre."""
    parts = nodes.node("ShaderNodeSeparateXYZ")
    nodes.feed(parts.inputs[0], nodes.rest())
    wave = nodes.math("SINE", nodes.math("MULTIPLY", parts.outputs["XYZ".index(axis)], 6.2831853 * scale))
    return nodes.spread(wave, 0.0, 1.0, (-sharpness, sharpness))


def _pattern(nodes: Nodes, layer: dict[str, Any]) -> Any:
    kind, scale = layer["pattern"], layer["scale"]
    if kind == "plain":
        return _noise(nodes, scale)
    if kind == "noise":
        return _noise(nodes, scale, detail=5.0)
    if kind == "stripes":
        return _bands(nodes, scale, "X", 0.6)
    if kind == "plaid":
        return nodes.math("MULTIPLY", nodes.math("ADD", _bands(nodes, scale, "X"), _bands(nodes, scale, "Z")), 0.5)
    if kind == "checks":
        differ = nodes.math("SUBTRACT", _bands(nodes, scale, "X"), _bands(nodes, scale, "Z"))
        return nodes.math("ABSOLUTE", differ)
    if kind == "spots":
        cells = nodes.node("ShaderNodeTexVoronoi")
        nodes.feed(cells.inputs["Vector"], nodes.rest())
        cells.inputs["Scale"].default_value = scale
        return nodes.spread(cells.outputs["Distance"], 1.0, 0.0, (0.25, 0.35))
    if kind == "brushed":
        return _noise(nodes, scale, 2.0, (0.15, 0.15, 1.0))
    raise ValueError(f"unknown pattern {kind!r}")


def _color(nodes: Nodes, layer: dict[str, Any]) -> Any:
    first, second = layer["colors"]
    color = nodes.mix(_pattern(nodes, layer), first, second, "RGBA")
    worn = [0.8 * c for c in second]
    return nodes.mix(nodes.math("MULTIPLY", _noise(nodes, 7.0), 0.25), color, worn, "RGBA")


def _roughness(nodes: Nodes, layer: dict[str, Any]) -> Any:
    low, high = layer["roughness"]
    fine, wide = _noise(nodes, 33.0), _noise(nodes, 6.0)
    both = nodes.math("ADD", nodes.math("MULTIPLY", fine, 0.4), nodes.math("MULTIPLY", wide, 0.6))
    return nodes.spread(both, low, high, (0.2, 0.8))
