"""The lat-long environment map at a place of the scene."""

from __future__ import annotations

import math
from typing import Any

import bpy
import versions  # type: ignore[import-not-found]
from mathutils import Matrix, Vector

_RADIUS = 0.02  # metres, of the ball about the camera
_FACING = Matrix.Rotation(math.radians(-90), 4, "Z") @ Matrix.Rotation(math.radians(90), 4, "X")
"""Turns a camera so that the middle of its panorama looks along +X with +Z up."""


def prepare(request: dict[str, Any]) -> None:
    """Sets a panorama camera at a place, turned by the actor's yaw.

    Camera rays do not see lamps. The camera therefore stands in a small ball of refractive index 1: behind it, rays
    are transmission rays, which see whatever lights an actor, and nothing that only the camera sees.
    """
    scene, render = bpy.context.scene, bpy.context.scene.render
    place = Vector(request["place"])
    lens = bpy.data.cameras.new("yesnt panorama")
    versions.panorama(lens)
    lens.clip_start, lens.clip_end = 0.001, 1e5
    made = bpy.data.objects.new("yesnt panorama", lens)
    made.matrix_world = Matrix.Translation(place) @ Matrix.Rotation(math.radians(request["yaw"]), 4, "Z") @ _FACING
    scene.collection.objects.link(made)
    scene.camera = made
    render.resolution_x, render.resolution_y, render.resolution_percentage = 2 * request["rows"], request["rows"], 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1
    _ball(place)
    cycles = scene.cycles
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0  # lamps must keep their energy
    cycles.max_bounces += 1
    cycles.transmission_bounces += 1
    for lamp in [one for one in bpy.data.objects if one.type == "LIGHT"]:
        _widen(lamp, place, math.pi / request["rows"])


def _ball(place: Vector) -> None:
    bpy.ops.mesh.primitive_uv_sphere_add(radius=_RADIUS, location=place)
    ball = bpy.context.object
    material = bpy.data.materials.new("yesnt ball")
    tree = versions.use_nodes(material)
    tree.nodes.clear()
    shader, out = tree.nodes.new("ShaderNodeBsdfRefraction"), tree.nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["IOR"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.0
    tree.links.new(shader.outputs["BSDF"], out.inputs["Surface"])
    ball.data.materials.append(material)
    ball.visible_shadow = ball.visible_diffuse = ball.visible_glossy = ball.visible_transmission = False


def _widen(lamp: Any, place: Vector, texel: float) -> None:
    """Makes a lamp at least as large as a texel of the map sees it, with the same power: rays do not hit a point."""
    light = lamp.data
    if light.type == "SUN":
        light.angle = max(light.angle, 2 * texel)
    elif light.type in {"POINT", "SPOT"}:
        distance = (lamp.matrix_world.translation - place).length
        light.shadow_soft_size = max(light.shadow_soft_size, distance * texel)
