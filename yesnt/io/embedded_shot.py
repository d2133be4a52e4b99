"""The shot that comes with the package, and the template of a new one."""

from __future__ import annotations

import shutil
from pathlib import Path

from yesnt.core.errors import JobError

SHOT = Path(__file__).parent.parent / "data" / "shot"
"""The embedded shot: inputs in the contract's form and the truth beside them."""

_TEMPLATE = """\
# Job file of yesnt; docs/contract.md lists every key. Paths are relative to this file, absolute, or start with ~;
# #### is the frame number.
version: 1
name: {name}
frames: 1001-1024                 # also 1001-1100x2 and lists with commas

plate:   {{path: plate/plate.####.exr, colorspace: lin_rec709}}   # or ACEScg, srgb, ...; docs/files.md: channels, alpha
# matte: {{path: matte/matte.####.png}}                            # coverage, if the plate has no alpha
gbuffer: {{path: gbuffer/gbuffer.####.exr, z: depth.Z, normal: N, normal_space: world}}   # depth.Z and N.X N.Y N.Z
camera:  camera.json              # `yesnt camera FILE --write camera.json` makes it from .chan, Alembic or USD,
#   `yesnt camera --blender-script` prints an exporter for Blender, `yesnt camera camera.json` says what it means

light:   {{path: env/light.exr, convention: blender, rotation: [0, 0, 0], exposure: 0}}   # degrees, stops
#   env/light.####.exr: one map a frame; convention: blender | opengl | mitsuba; clamp: 100 (largest radiance kept);
#   rotation: {{1001: [0, 0, 0], 1024: [90, 0, 0]}}: animated, linear between keys; so is exposure: {{1001: 0, 1024: 1}}
#   captured_at: [0, 0, 1] and distance: 5 (metres): reprojected for the places of the actor and the camera
# capture_light: {{path: env/capture.exr}}        # the light of the plate; absent: uniform, radiance 1; or `estimate`
# background: {{path: bg/bg.####.exr}}            # absent: the light's map as the camera sees it
# proxy: {{path: proxy/proxy.####.ply}}           # triangles in world metres: cast shadows and reflect light

# color: {{config: $OCIO, working: acescg, output: ACEScg, view: "ACES 2.0 - SDR 100 nits (Rec.709)"}}   # OpenColorIO

decompose: {{backend: embedded, samples: 2}}      # or existing passes: {{path: material/material.####.exr}}
#   materials: [{{mask: mask/belt.####.exr, metallic: 1, roughness: 0.2}}] corrects it; or cryptomatte: with names:
quality: standard                 # draft | standard | final | reference
seed: 0
output: out
"""

_FOLDERS = ("plate", "gbuffer", "env", "proxy")


def copy_embedded_shot(folder: Path) -> Path:
    """Copies the embedded shot's inputs to a folder, where the user can change them; returns its job file.

    What lies there already is kept, so that a second demo resumes.

    Raises:
        JobError: the folder holds something else.
    """
    target = folder / "shot.yaml"
    if folder.exists() and any(folder.iterdir()) and not target.exists():
        raise JobError(
            "The folder is not empty", str(folder), "an empty or new folder, or an earlier demo", "name another"
        )
    if not target.exists():
        shutil.copytree(SHOT, folder, dirs_exist_ok=True)
    return target


def write_template(folder: Path) -> Path:
    """Writes a commented job file and the folders that it expects.

    Raises:
        JobError: there is a job file already.
    """
    target = folder / "shot.yaml"
    if target.exists():
        raise JobError("There is a job file already", str(target), "a folder without one", "name another folder")
    for name in _FOLDERS:
        (folder / name).mkdir(parents=True, exist_ok=True)
    target.write_text(_TEMPLATE.format(name=folder.absolute().name))
    return target
