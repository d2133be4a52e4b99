"""Runs Blender on a user's scene and reads what it rendered."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.blender_set.place import ActorPlace, camera_of
from yesnt.blender_set.settings import DEPTH_FACTOR, BlenderSettings
from yesnt.capture_stage.passes import read_passes
from yesnt.capture_stage.tools import Tools, run_script
from yesnt.core.camera import Camera
from yesnt.core.errors import CorruptError, YesntError

F32 = NDArray[np.float32]
_MAIN = Path(__file__).resolve().parent / "inside_blender" / "main.py"
_TIMEOUT = 6 * 3600.0  # seconds; a scene that renders longer than this for one frame is stuck
_GLOSSY = (("GlossDir", "GlossInd", "GlossCol"), ("Glossy Direct", "Glossy Indirect", "Glossy Color"))
"""Blender's names of the same passes, which changed in 5.0."""


@dataclass(frozen=True)
class SceneFile:
    """A scene and where the shot stands in it.

    Attributes:
        path: .blend, .gltf or .glb.
        place: of the shot's world.
        world: for glTF, which has no world: `path` of a lat-long EXR in Blender's convention and its `yaw`; else None.
    """

    path: Path
    place: ActorPlace
    world: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class PaintedMesh:
    """The proxy of a frame with the materials of its vertices.

    Attributes:
        vertices: [V, 3] world metres.
        faces: [F, 3].
        base_color: [V, 3] linear Rec.709.
        roughness: [V].
        metallic: [V].
        emission: strength of white light that it sends out; 0 but in tests of what the camera sees.
    """

    vertices: F32
    faces: NDArray[np.int32]
    base_color: F32
    roughness: F32
    metallic: F32
    emission: float = 0.0


@dataclass(frozen=True)
class SetPlate:
    """A plate of the scene: radiance [H, W, 3] linear Rec.709, and the part of it that glossy surfaces reflect."""

    radiance: F32
    glossy: F32


@dataclass(frozen=True)
class SetPictures:
    """What Blender renders of one frame.

    Attributes:
        without: the scene.
        present: the scene with the proxy, which the camera does not see.
        depth: [n H, n W] planar metres, n = `DEPTH_FACTOR`; 1e10 where nothing is hit.
    """

    without: SetPlate
    present: SetPlate
    depth: F32


@dataclass(frozen=True)
class View:
    """The shot's camera in one frame."""

    camera: Camera
    frame: int


def render_frame(
    scene: SceneFile, view: View, mesh: PaintedMesh, settings: BlenderSettings, tools: Tools, work: Path
) -> SetPictures:
    """Renders the scene of one frame.

    Args:
        scene: the scene.
        view: camera and frame; frames of the shot are frames of the scene's animation.
        mesh: the proxy in that frame.
        settings: samples.
        tools: Blender.
        work: folder of this request; pictures that are in it are not rendered again.

    Raises:
        YesntError: Blender failed, or the scene cannot be used.
    """
    work.mkdir(parents=True, exist_ok=True)
    archive = work / "proxy.npz"
    arrays = {name: getattr(mesh, name) for name in ("vertices", "faces", "base_color", "roughness", "metallic")}
    np.savez(archive, **arrays)
    out = {name: work / f"{name}.exr" for name in ("without", "with", "depth")}
    request = {
        **_request(scene, "frame", out), "frame": view.frame,
        "samples": settings.samples, "depth_factor": DEPTH_FACTOR,
        "camera": camera_of(view.camera, view.frame, scene.place),
        "proxy": {
            "archive": str(archive), "emission": mesh.emission,
            "scene_from_world": scene.place.scene_from_world.tolist(),
        },
    }  # fmt: skip
    _run(request, tools, work)
    depth = read_passes(out["depth"])["Depth.Z"]
    return SetPictures(_plate(out["without"]), _plate(out["with"]), depth)


def bake_map(
    scene: SceneFile, frame: int, point: NDArray[np.float64], settings: BlenderSettings, tools: Tools, work: Path
) -> F32:
    """The environment map at a point of the shot's world: [rows, 2 rows, 3], Blender's convention, world axes.

    Args:
        scene: the scene.
        frame: of its animation.
        point: [3] metres in the shot's world.
        settings: size and samples.
        tools: Blender.
        work: folder of this request.

    Raises:
        YesntError: as `render_frame`; or nothing shines at the point.
    """
    work.mkdir(parents=True, exist_ok=True)
    out = {"map": work / "map.exr"}
    place = scene.place.to_scene(point)
    request = {
        **_request(scene, "bake", out), "frame": frame, "place": place.tolist(), "yaw": scene.place.yaw,
        "rows": settings.map_rows, "samples": settings.map_samples,
    }  # fmt: skip
    _run(request, tools, work)
    radiance = _plate(out["map"]).radiance
    if not radiance.max() > 0:
        raise YesntError(
            "No light arrives at the actor's place", f"{scene.path}, at {place.round(3).tolist()}",
            "a lamp, an emitter or a world that shines there",
            "move `set.at` out of what encloses it, light the scene, or give `light: {path: ...}`",
        )  # fmt: skip
    return radiance


def scene_facts(path: Path, tools: Tools, work: Path) -> dict[str, Any]:
    """Files that the scene is made from, its colour space, Blender's version, and whether it denoises.

    Raises:
        YesntError: Blender cannot open the scene, or it uses files that are not there.
    """
    work.mkdir(parents=True, exist_ok=True)
    out = {"facts": work / "facts.json"}
    out["facts"].unlink(missing_ok=True)
    _run(_request(SceneFile(path, ActorPlace()), "facts", out), tools, work)
    found: dict[str, Any] = json.loads(out["facts"].read_text())
    return found


def _request(scene: SceneFile, what: str, out: Mapping[str, Path]) -> dict[str, Any]:
    return {
        "what": what, "scene": str(scene.path), "world": dict(scene.world) if scene.world else None,
        "out": {name: str(path) for name, path in out.items()},
    }  # fmt: skip


def _run(request: Mapping[str, Any], tools: Tools, work: Path) -> None:
    missing = [Path(path) for path in request["out"].values() if not _is_whole(Path(path))]
    if not missing:
        return
    for path in missing:
        path.unlink(missing_ok=True)
    asked = work / "request.json"
    asked.write_text(json.dumps({**request, "threads": tools.threads}, sort_keys=True))
    run_script(tools, _MAIN, [str(asked)], _TIMEOUT)


def _is_whole(path: Path) -> bool:
    """Whether a raw picture is there and decodes; otherwise it is rendered again."""
    try:
        return path.is_file() and (path.suffix != ".exr" or bool(read_passes(path)))
    except CorruptError:
        return False


def _plate(path: Path) -> SetPlate:
    """A plate; the denoiser's negative values become 0."""
    passes = read_passes(path)
    names = next(names for names in _GLOSSY if f"{names[0]}.R" in passes)
    direct, indirect, color = (_rgb(passes, name) for name in names)
    return SetPlate(np.maximum(_rgb(passes, "Combined"), 0), np.maximum((direct + indirect) * color, 0))


def _rgb(passes: Mapping[str, F32], name: str) -> F32:
    return np.stack([passes[f"{name}.{c}"] for c in "RGB"], axis=-1)
