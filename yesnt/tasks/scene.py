"""Tasks that put the subject into a scene of Blender: the map at its place, and the plates of a frame."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.blender_set.place import ActorPlace
from yesnt.blender_set.render import PaintedMesh, SceneFile, View, bake_map, render_frame
from yesnt.blender_set.settings import QUALITIES
from yesnt.capture_stage.tools import find_tools
from yesnt.core.scene_input import has_world
from yesnt.core.shot import Job
from yesnt.io.color_config import convert
from yesnt.io.exr import write_exr
from yesnt.io.file_digests import file_digest
from yesnt.io.jobfile import frame_path
from yesnt.io.mesh import read_proxy
from yesnt.planning.stages import RELIGHT, SOLVE
from yesnt.planning.task_records import BakeTask, SceneTask
from yesnt.tasks.captured_views import captured_views
from yesnt.tasks.inputs import prove_input
from yesnt.tasks.light import LightFiles, frame_map
from yesnt.tasks.unseen_sides import measured_sides
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.scene.scene_layers import SceneLayers

F32 = NDArray[np.float32]


def bake_light(space: Workspace[BakeTask]) -> None:
    """Bakes the environment map at the actor's place and commits the file.

    The place is the mean of the middles of the proxies' bounding boxes.
    """
    job = space.job
    middles = [_middle(space, frame) for frame in space.task.frames]
    work = space.output.blender / f"bake-{space.node.key[:16]}"
    with space.kernel():
        scene = _scene_file(job, None)
        radiance = bake_map(
            scene, space.frame, np.mean(middles, axis=0), QUALITIES[job.shot.quality], find_tools(Path()), work
        )
    _prove_scene(space)
    path = space.output.baked_light
    path.parent.mkdir(parents=True, exist_ok=True)
    write_exr(path, {c: np.ascontiguousarray(radiance[..., i]) for i, c in enumerate("RGB")})
    space.commit(space.frame, {}, {str(path.relative_to(space.output.root)): file_digest(path)})
    shutil.rmtree(work)


def render_scene(space: Workspace[SceneTask]) -> None:
    """Commits the layers of the set of one frame."""
    from yesnt.scene.scene_layers import scene_layers

    job, frame, camera = space.job, space.frame, space.camera()
    plate, seen = space.plate(frame, working=True), space.surface(frame, camera)
    work = space.output.blender / f"set-{space.node.key[:16]}"
    work.mkdir(parents=True, exist_ok=True)
    with space.kernel():
        mesh = _painted(space)
        scene = _scene_file(job, _world(space, work))
        found = render_frame(scene, View(camera, frame), mesh, QUALITIES[job.shot.quality], find_tools(Path()), work)
        planes = [_working(job, p) for p in (found.without, found.present)]
        layers = scene_layers(planes[0], planes[1], found.depth, (seen.z, plate.matte))
    _prove_scene(space)
    space.commit(frame, _channels(layers))
    shutil.rmtree(work)


def _channels(layers: SceneLayers) -> dict[str, F32]:
    return {
        "set_open": layers.open.transpose(2, 0, 1),
        "set_ratio": layers.ratio.transpose(2, 0, 1),
        "set_added": layers.added.transpose(2, 0, 1),
        "holdout": layers.holdout[None],
        "front": layers.front.transpose(2, 0, 1),
    }


def _painted(space: Workspace[SceneTask]) -> PaintedMesh:
    """The proxy of the frame with the base colour and the materials that the store holds, and cameras elsewhere say."""
    from yesnt.relight import ProxyScene
    from yesnt.scene.vertex_materials import vertex_values
    from yesnt.tasks.relight_inputs import RelightInputs

    job, frame, camera, mesh = space.job, space.frame, space.camera(), space.inputs.proxy()
    assert mesh is not None, "the job's own check"
    base, material = space.read(RELIGHT, "base_color", frame).transpose(1, 2, 0), space.read(SOLVE, "material", frame)
    values = np.concatenate([base, material.transpose(1, 2, 0)], axis=-1)
    plate, seen = space.plate(frame, working=True), space.surface(frame, camera)
    views = captured_views(space) if space.task.cameras else []
    proxy = ProxyScene.from_arrays(mesh.vertices, mesh.faces)
    surface = RelightInputs(plate, seen, camera, frame, proxy).surface(material)
    measured = measured_sides(space, views, surface, proxy)
    found = vertex_values((mesh.vertices, mesh.faces), (camera, frame), values, plate.matte, seen.z, measured)
    color = np.clip(convert(found[:, :3], job.colors.to_scene), 0, 1)
    return PaintedMesh(mesh.vertices, mesh.faces, color, found[:, 3], found[:, 4])


def _working(job: Job, plate: Any) -> tuple[F32, F32]:
    """Radiance and glossy part of a plate in the working space."""
    return convert(plate.radiance, job.colors.scene), convert(plate.glossy, job.colors.scene)


def _scene_path(job: Job) -> Path:
    assert job.shot.scene is not None, "only jobs with a scene have these tasks"
    return frame_path(job.root, job.shot.scene, 0)


def _scene_file(job: Job, world: dict[str, Any] | None) -> SceneFile:
    given = job.shot.set
    assert given is not None, "only jobs with a scene have these tasks"
    return SceneFile(_scene_path(job), ActorPlace(given.at, given.yaw), world)


def _world(space: Workspace[SceneTask], work: Path) -> dict[str, Any] | None:
    """For glTF, which has no world, the job's light as a map of Blender's; turned with the actor."""
    job, frame = space.job, space.frame
    if has_world(_scene_path(job).name) or job.shot.light.set:
        return None
    from yesnt.relight.envmap import uv_to_direction

    env = frame_map(job, job.shot.light, frame)
    prove_input(frame_path(job.root, str(job.shot.light.path), frame), LightFiles.of_task(space).digests.get("light"))
    rows, columns = env.radiance.shape[:2]
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    radiance = convert(env.lookup(uv_to_direction(u, v)), job.colors.to_scene)
    write_exr(work / "world.exr", {c: np.ascontiguousarray(radiance[..., i]) for i, c in enumerate("RGB")})
    return {"path": str(work / "world.exr"), "yaw": job.shot.set.yaw if job.shot.set else 0.0}


def _prove_scene(space: Workspace[Any]) -> None:
    """Raises JobError if the scene's file was replaced while Blender read it."""
    prove_input(_scene_path(space.job), space.node.inputs.get("scene"))


def _middle(space: Workspace[BakeTask], frame: int) -> NDArray[np.float64]:
    """Middle [3] of the bounding box of a frame's proxy, world metres."""
    proxy = space.job.shot.proxy
    assert proxy is not None, "the job's own check"
    vertices = read_proxy(space.job, frame).vertices.astype(np.float64)
    prove_input(frame_path(space.job.root, proxy.path, frame), space.node.inputs.get(f"probe proxy {frame}"))
    middle: NDArray[np.float64] = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return middle
