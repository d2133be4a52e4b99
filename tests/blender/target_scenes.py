"""A dozen small scenes that a subject is put into: `python target_scenes.py FOLDER [NAME ...]`, or with `blender -b`.

    blender -b --python target_scenes.py -- FOLDER ...

Writes FOLDER/NAME.blend, and FOLDER/maps/NAME.exr, the lat-long maps of the worlds. The subject stands at the origin
and faces -Y, unless `PLACES` says otherwise. The four scenes of `GROUNDS` are a plane at z = 0 with one material under
a map and nothing else, which the built-in set shows too.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from target_scenes_names import GROUNDS  # type: ignore[import-not-found]

PLACES: dict[str, tuple[tuple[float, float, float], float]] = {"podium": ((1.5, 2.0, 0.6), 30.0)}
"""`at` and `yaw` of scenes whose actor does not stand at the origin."""

GROUND_SIZE = 20.0  # metres


def main() -> None:
    """Writes the scenes that the command line names, or all."""
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    folder, names = Path(arguments[0]).resolve(), arguments[1:] or list(SCENES)
    (folder / "maps").mkdir(parents=True, exist_ok=True)
    for name in names:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.scene.render.engine = "CYCLES"
        cycles = bpy.context.scene.cycles
        cycles.sample_clamp_indirect = cycles.blur_glossy = (
            0.0  # truth is not clamped, nor its mirrors rough in bounces
        )
        SCENES[name](folder)
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{name}.blend"), compress=True, relative_remap=True)


def ground(folder: Path, name: str) -> None:
    """A plane under a map."""
    light, color, roughness, metallic = GROUNDS[name]
    world_map(folder, light)
    plane("ground", (0, 0, 0), GROUND_SIZE, paint("ground", color, roughness, metallic))


def room(folder: Path) -> None:
    """Indoors: walls, a window of light from the left, a lamp at the ceiling."""
    world_color((0.02, 0.02, 0.03))
    _walls((0.6, 0.58, 0.52))
    lamp("AREA", (-2.9, -0.5, 1.6), (0, -90, 0), 180, size=1.6, color=(0.75, 0.85, 1.0))
    lamp("POINT", (0.6, 0.8, 2.7), (0, 0, 0), 60, shadow_soft_size=0.12, color=(1.0, 0.8, 0.55))


def corridor(folder: Path) -> None:
    """Indoors: a long corridor with a row of lamps and a waxed floor."""
    world_color((0.01, 0.01, 0.01))
    wall, floor = paint("wall", (0.7, 0.68, 0.6), 0.9), paint("floor", (0.2, 0.12, 0.08), 0.15)
    box((0, 4, -0.05), (2.4, 14, 0.1), floor)
    for x in (-1.2, 1.2):
        box((x, 4, 1.4), (0.1, 14, 2.9), wall)
    for y in (-1.0, 2.0, 5.0):
        lamp("AREA", (0, y, 2.7), (0, 0, 0), 70, size=0.5)


def night_street(folder: Path) -> None:
    """Night: a street lamp, a car's tail light, a wet road."""
    world_color((0.003, 0.005, 0.012))
    plane("road", (0, 0, 0), 30, paint("road", (0.05, 0.05, 0.055), 0.28))
    box((0, 4, 1.5), (8, 0.2, 3), paint("wall", (0.3, 0.18, 0.14), 0.9))
    lamp("SPOT", (-1.2, -0.4, 4.0), (0, -12, 0), 900, spot_size=1.4, shadow_soft_size=0.15, color=(1.0, 0.72, 0.4))
    lamp("POINT", (1.8, 0.8, 0.7), (0, 0, 0), 25, shadow_soft_size=0.06, color=(1.0, 0.08, 0.04))


def yard(folder: Path) -> None:
    """Outdoors: a sun lamp and sky, a wall beside the actor."""
    world_color((0.25, 0.35, 0.55))
    plane("ground", (0, 0, 0), 30, paint("ground", (0.4, 0.33, 0.25), 0.9))
    box((1.4, 1.0, 1.0), (0.3, 3, 2), paint("wall", (0.75, 0.2, 0.12), 0.8))
    lamp("SUN", (0, 0, 5), (40, 0, -50), 4.0, angle=math.radians(0.53), color=(1.0, 0.93, 0.8))


def pillar(folder: Path) -> None:
    """A column in front of half of the actor."""
    yard(folder)
    bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=0.09, depth=2.4, location=(-0.1, -1.2, 1.2))
    bpy.context.object.data.materials.append(paint("column", (0.85, 0.85, 0.8), 0.6))


def fence(folder: Path) -> None:
    """Thin bars before the actor: most of their pixels are covered in part."""
    world_map(folder, "overcast")
    plane("ground", (0, 0, 0), GROUND_SIZE, paint("ground", (0.3, 0.36, 0.2), 0.9))
    bars = paint("bars", (0.05, 0.05, 0.06), 0.4, 0.0)
    for i in range(-6, 7):
        box((0.16 * i, -0.9, 0.45), (0.012, 0.012, 0.9), bars)
    box((0, -0.9, 0.9), (2.2, 0.02, 0.02), bars)


def leaves(folder: Path) -> None:
    """Cards with cut-out leaves before the actor: transparency, not geometry."""
    world_map(folder, "sunny")
    plane("ground", (0, 0, 0), GROUND_SIZE, paint("ground", (0.3, 0.36, 0.2), 0.9))
    bpy.ops.mesh.primitive_plane_add(size=1, location=(0.25, -0.8, 0.4), rotation=(math.radians(90), 0, 0))
    bpy.context.object.data.materials.append(_cut_out())


def podium(folder: Path) -> None:
    """A raised stage away from the origin; the actor is turned by 30 degrees."""
    world_map(folder, "studio")
    plane("ground", (0, 0, 0), GROUND_SIZE, paint("ground", (0.3, 0.3, 0.32), 0.6))
    box((1.5, 2.0, 0.3), (2.4, 2.4, 0.6), paint("podium", (0.55, 0.2, 0.15), 0.35))


def mirror_wall(folder: Path) -> None:
    """A mirror behind the actor, which shows its back."""
    room(folder)
    bpy.ops.mesh.primitive_plane_add(size=2, location=(0.3, 1.3, 1.1), rotation=(math.radians(90), 0, math.radians(8)))
    bpy.context.object.data.materials.append(paint("mirror", (0.95, 0.95, 0.95), 0.0, 1.0))


def moving_lamp(folder: Path) -> None:
    """A lamp that moves from the left to the right between the frames 1001 and 1016."""
    world_color((0.05, 0.05, 0.06))
    plane("ground", (0, 0, 0), GROUND_SIZE, paint("ground", (0.5, 0.5, 0.5), 0.7))
    made = lamp("POINT", (-1.5, -1, 1.5), (0, 0, 0), 80, shadow_soft_size=0.1)
    for frame, x in ((1001, -1.5), (1016, 1.5)):
        made.location.x = x
        made.keyframe_insert("location", frame=frame)


SCENES: dict[str, Callable[[Path], None]] = {
    **{name: lambda folder, name=name: ground(folder, name) for name in GROUNDS},  # type: ignore[misc]
    "room": room, "corridor": corridor, "night_street": night_street, "yard": yard, "pillar": pillar, "fence": fence,
    "leaves": leaves, "podium": podium, "mirror_wall": mirror_wall, "moving_lamp": moving_lamp,
}  # fmt: skip


def _walls(color: tuple[float, float, float]) -> None:
    wall = paint("wall", color, 0.9)
    plane("floor", (0, 0, 0), 6, paint("floor", (0.35, 0.22, 0.12), 0.4))
    plane("ceiling", (0, 0, 3), 6, wall)
    box((0, 3, 1.5), (6, 0.1, 3), wall)
    for x in (-3, 3):
        box((x, 0, 1.5), (0.1, 6, 3), wall)


def plane(name: str, place: Iterable[float], size: float, material: Any) -> None:
    """A horizontal square."""
    bpy.ops.mesh.primitive_plane_add(size=size, location=tuple(place))
    bpy.context.object.name = name
    bpy.context.object.data.materials.append(material)


def box(place: Iterable[float], size: Iterable[float], material: Any) -> None:
    """A box by its middle and its sides."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=tuple(place))
    bpy.context.object.scale = tuple(size)
    bpy.context.object.data.materials.append(material)


def lamp(kind: str, place: Iterable[float], turn: Iterable[float], power: float, **knobs: Any) -> Any:
    """A lamp; `turn` in degrees."""
    light = bpy.data.lights.new(kind.lower(), kind)
    light.energy = power
    for name, value in knobs.items():
        setattr(light, name, value)
    made = bpy.data.objects.new(kind.lower(), light)
    made.location, made.rotation_euler = tuple(place), tuple(math.radians(a) for a in turn)
    bpy.context.scene.collection.objects.link(made)
    return made


def paint(name: str, color: tuple[float, float, float], roughness: float, metallic: float = 0.0) -> Any:
    """A Principled BSDF of one base colour."""
    material = bpy.data.materials.new(name)
    inputs = _nodes(material)["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*color, 1)
    inputs["Roughness"].default_value, inputs["Metallic"].default_value = roughness, metallic
    return material


def _cut_out() -> Any:
    """A leaf colour that is opaque inside discs and fully transparent between them."""
    material = paint("leaf", (0.12, 0.3, 0.06), 0.5)
    tree = material.node_tree
    place, cells = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexVoronoi")
    cells.inputs["Scale"].default_value, cells.inputs["Randomness"].default_value = 7.0, 0.6
    inside = tree.nodes.new("ShaderNodeMath")
    inside.operation = "LESS_THAN"
    inside.inputs[1].default_value = 0.42
    tree.links.new(place.outputs["UV"], cells.inputs["Vector"])
    tree.links.new(cells.outputs["Distance"], inside.inputs[0])
    tree.links.new(inside.outputs["Value"], tree.nodes["Principled BSDF"].inputs["Alpha"])
    return material


def _nodes(owner: Any) -> Any:
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    return owner.node_tree.nodes


def world_color(color: tuple[float, float, float]) -> None:
    """A world of one radiance."""
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    _nodes(world)["Background"].inputs["Color"].default_value = (*color, 1)


def world_map(folder: Path, name: str) -> None:
    """A world that is one of the maps, which is written if it is not there."""
    path = folder / "maps" / f"{name}.exr"
    if not path.exists():
        _write_map(path, MAPS[name]())
    world_color((0, 0, 0))
    tree = bpy.context.scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(path))
    tree.links.new(texture.outputs["Color"], tree.nodes["Background"].inputs["Color"])


def _write_map(path: Path, radiance: Any) -> None:
    """A lat-long map [H, W, 3], row 0 up, as a float EXR."""
    height, width = radiance.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, float_buffer=True, is_data=True)
    rgba = np.concatenate([radiance[::-1], np.ones((height, width, 1))], axis=-1)
    image.pixels.foreach_set(np.ascontiguousarray(rgba, dtype=np.float32).ravel())
    settings = bpy.context.scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    image.save_render(str(path), scene=bpy.context.scene)
    bpy.data.images.remove(image)


def _directions(height: int = 128) -> Any:
    """Unit directions [H, 2 H, 3] of a map's texels: the middle column looks along +X, u = 0.25 along +Y."""
    v = (np.arange(height) + 0.5) / height * np.pi
    angle = (0.5 - (np.arange(2 * height) + 0.5) / (2 * height)) * 2 * np.pi
    up, out = np.cos(v)[:, None] * np.ones_like(angle), np.sin(v)[:, None]
    return np.stack([out * np.cos(angle), out * np.sin(angle), up], axis=-1)


def _spot(way: Any, azimuth: float, elevation: float, radius: float) -> Any:
    """1 within `radius` degrees of a direction, [H, W, 1], with an edge of a texel."""
    a, e = math.radians(azimuth), math.radians(elevation)
    aim = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    angle = np.degrees(np.arccos(np.clip(way @ aim, -1, 1)))
    return np.clip((radius - angle) / 1.4 + 0.5, 0, 1)[..., None]


def _sky(way: Any, zenith: Any, horizon: Any, below: Any) -> Any:
    up = way[..., 2:]
    sky = np.asarray(horizon) + (np.asarray(zenith) - np.asarray(horizon)) * np.clip(up, 0, 1) ** 0.6
    return np.where(up >= 0, sky, np.asarray(below))


def _overcast() -> Any:
    way = _directions()
    return _sky(way, (1.1, 1.15, 1.25), (0.5, 0.55, 0.62), (0.2, 0.18, 0.15)) + 1.2 * _spot(way, -120, 55, 35)


def _sunny() -> Any:
    way = _directions()
    sun = _spot(way, -140, 40, 4) * np.array((220.0, 195.0, 150.0))
    return _sky(way, (0.16, 0.3, 0.7), (0.55, 0.62, 0.7), (0.2, 0.17, 0.13)) + sun


def _studio() -> Any:
    way = _directions()
    key, rim = _spot(way, -135, 35, 16) * np.array((14.0, 12.0, 10.0)), _spot(way, 50, 25, 12) * np.array((4.0, 6, 9))
    return _sky(way, (0.10, 0.10, 0.12), (0.22, 0.2, 0.2), (0.08, 0.08, 0.08)) + key + rim


MAPS: dict[str, Callable[[], Any]] = {"overcast": _overcast, "sunny": _sunny, "studio": _studio}

if __name__ == "__main__":
    main()
