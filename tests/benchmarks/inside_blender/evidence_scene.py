"""Runs in Blender's Python: renders the objects of a scene file under each map from each camera.

    python evidence_scene.py FOLDER MAP,...

FOLDER/scene.json holds objects (vertices, faces, materials) and cameras (OpenCV poses); pictures become MAP.NUMBER.exr.
"""

import json
import sys
from itertools import pairwise
from pathlib import Path

import bpy
from mathutils import Matrix

SAMPLES = 64


def build(scene, objects):
    for entry in objects:
        mesh = bpy.data.meshes.new(entry["name"])
        mesh.from_pydata(entry["vertices"], [], entry["faces"])
        for polygon in mesh.polygons:
            polygon.use_smooth = entry["smooth"]
        material = bpy.data.materials.new(entry["name"])
        material.use_nodes = True
        shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = (*entry["base"], 1)
        shader.inputs["Metallic"].default_value = entry["metallic"]
        shader.inputs["Roughness"].default_value = entry["roughness"]
        mesh.materials.append(material)
        scene.collection.objects.link(bpy.data.objects.new(entry["name"], mesh))


def world(scene):
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    chain = [tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Background", "OutputWorld")]
    for one, other in pairwise(chain):
        tree.links.new(one.outputs[0], other.inputs[0])
    return chain[0]


def configure(scene, size):
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = SAMPLES, False
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = scene.cycles.blur_glossy = 0
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = size
    image = scene.render.image_settings
    image.file_format, image.color_depth, image.color_mode = "OPEN_EXR", "32", "RGBA"


def main(folder, maps):
    document = json.loads((folder / "scene.json").read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    configure(scene, document["size"])
    build(scene, document["objects"])
    environment = world(scene)
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", 36, 36 * document["fx"] / document["size"]
    scene.camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(scene.camera)
    for name in maps:
        environment.image = bpy.data.images.load(str(folder / f"{name}.exr"))
        environment.image.colorspace_settings.name = "Linear Rec.709"
        for number, pose in enumerate(document["poses"]):
            scene.camera.matrix_world = Matrix(pose) @ Matrix.Diagonal((1, -1, -1, 1))
            scene.render.filepath = str(folder / f"{name}.{number}.exr")
            bpy.ops.render.render(write_still=True)


main(Path(sys.argv[-2]), sys.argv[-1].split(","))
