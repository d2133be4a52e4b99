"""A subject of the capture stage in a target scene: truth, and the shot that the product is given.

`python set_truth_scene.py request.json`. Writes raw multi-layer EXRs and proxies; `set_truth.py` makes a shot of them.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "yesnt" / "capture_stage" / "inside_blender"))
sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "yesnt" / "blender_set" / "inside_blender"))
import materials  # type: ignore[import-not-found]
import scenes  # type: ignore[import-not-found]
import subjects  # type: ignore[import-not-found]
import versions  # type: ignore[import-not-found]


def main() -> None:
    """Renders the set with and without the subject, then the subject alone under a uniform light."""
    request = json.loads(Path(sys.argv[-1]).read_text())
    out = Path(request["out"])
    scenes.open_scene({"scene": request["scene"], "threads": request["threads"]})
    surroundings = [one for one in bpy.data.objects if one.type in {"MESH", "LIGHT"}]
    meshes = subjects.add_subject(request["subject"], [{"frame": 1001, "shape": 0}])
    scenes.camera(request["camera"])
    scene = bpy.context.scene
    scene.frame_set(1001)
    layer = versions.single_layer(scene)
    layer.use_pass_normal = True
    for name, kind in materials.AOVS:
        aov = layer.aovs.add()
        aov.name, aov.type = name, kind
    subjects.write_ply(out / "true.ply", *subjects.decimated(meshes, 10**9))
    subjects.write_ply(out / "decimated.ply", *subjects.decimated(meshes, request["triangles"]))
    _render(out / "truth.exr", request["samples"])
    _hide(meshes, True)
    _render(out / "without.exr", request["samples"])
    _hide(meshes, False)
    _hide(surroundings, True)
    _uniform_light()
    scene.render.film_transparent = True
    _render(out / "plate.exr", request["samples"])
    scene.cycles.filter_width = 0.01
    _render(out / "points.exr", 1)


def _hide(objects: list[Any], hidden: bool) -> None:
    for one in objects:
        one.hide_render = hidden


def _uniform_light() -> None:
    world = bpy.data.worlds.new("uniform")
    versions.use_nodes(world).nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    bpy.context.scene.world = world


def _render(path: Path, samples: int) -> None:
    """Renders one picture, unless an earlier run that was stopped has made it."""
    if path.exists():
        return
    scene, unfinished = bpy.context.scene, path.with_name("unfinished.exr")
    scene.cycles.samples, scene.cycles.use_denoising = samples, samples > 1 and versions.denoises()
    versions.render_to(scene, str(unfinished))
    unfinished.rename(path)


if __name__ == "__main__":
    main()
