"""Renders what one request asks for: `python main.py request.json`, or `blender -b --python main.py -- request.json`.

Pictures are raw multi-layer EXRs, written under temporary names and renamed when whole; the host makes channels of
them. A mistake of the scene ends the process with status 3 and one line of JSON on stderr: what, expected, do.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
import actor  # type: ignore[import-not-found]
import bake  # type: ignore[import-not-found]
import scenes  # type: ignore[import-not-found]
import versions  # type: ignore[import-not-found]

_POINT_FILTER_WIDTH = 0.01  # pixels: depth is read at the sampled points themselves


def main() -> None:
    """Opens the scene of the request and renders its pictures; each that is there already is left."""
    request = json.loads(Path(sys.argv[-1]).read_text())
    try:
        scenes.refuse_without_numpy()
        scenes.open_scene(request)
        _RUNNERS[request["what"]](request)
    except scenes.SceneError as error:
        sys.stderr.write(f"\nyesnt-error {json.dumps(error.args)}\n")
        sys.exit(3)


def _frame(request: dict[str, Any]) -> None:
    """The plates without and with the proxy, and the set's depth at points inside the pixels."""
    scene = bpy.context.scene
    scene.frame_set(request["frame"])
    scenes.camera(request["camera"])
    proxy = actor.add(request["proxy"])
    for name, hidden in (("without", True), ("with", False)):
        proxy.hide_render = hidden
        _render(request["out"][name], request["samples"], denoise=True)
    proxy.hide_render = True
    _depth(request)


def _depth(request: dict[str, Any]) -> None:
    """One ray through the middle of each of n by n squares of a pixel, no light."""
    scene, factor = bpy.context.scene, request["depth_factor"]
    scene.render.resolution_x *= factor
    scene.render.resolution_y *= factor
    scene.cycles.max_bounces = 0
    layer = versions.single_layer(scene)
    layer.use_pass_glossy_direct = layer.use_pass_glossy_indirect = layer.use_pass_glossy_color = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", _POINT_FILTER_WIDTH
    _render(request["out"]["depth"], 1)


def _bake(request: dict[str, Any]) -> None:
    """The lat-long map of what arrives at a place. Not denoised: a denoiser takes up to a quarter of a small lamp."""
    bpy.context.scene.frame_set(request["frame"])
    bake.prepare(request)
    _render(request["out"]["map"], request["samples"])


def _facts(request: dict[str, Any]) -> None:
    """What the host checks and hashes before a run."""
    Path(request["out"]["facts"]).write_text(json.dumps(scenes.facts()))


def _render(out: str, samples: int, denoise: bool = False) -> None:
    """Renders a picture; without a denoiser, four times the samples halve the noise."""
    if os.path.exists(out):
        return
    cycles = bpy.context.scene.cycles
    cycles.use_denoising = denoise and versions.denoises()
    cycles.samples = 4 * samples if denoise and not versions.denoises() else samples
    temporary = f"{out}.{os.getpid()}.exr"
    versions.render_to(bpy.context.scene, temporary)
    os.replace(temporary, out)


_RUNNERS = {"frame": _frame, "bake": _bake, "facts": _facts}

if __name__ == "__main__":
    main()
