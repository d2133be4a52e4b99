"""Task that lights the set in one frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.planning import settings as of
from yesnt.planning.stages import RELIGHT, SOLVE
from yesnt.planning.task_records import SetTask
from yesnt.tasks import relight_inputs
from yesnt.tasks.captured_views import captured_views
from yesnt.tasks.ground import read_ground
from yesnt.tasks.light import LightFiles, light_of_the_sun, map_behind, relighting_light
from yesnt.tasks.surroundings import surroundings
from yesnt.tasks.unseen_sides import measured_sides
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.relight.points import Surface
    from yesnt.relight.surroundings import Surroundings
    from yesnt.scene.ground import Ground
    from yesnt.scene.set_frame import SetLayers
    from yesnt.scene.set_view import SetImage

F32 = NDArray[np.float32]


def light_the_set(space: Workspace[SetTask]) -> None:
    """Commits what the set takes from and adds to the light, the holdout, and in `show` what is behind the subject.

    A job with light groups also gets the part of what is behind the subject that the map's sun lights.
    """
    from yesnt.scene.set_frame import RelitSubject, lit_set

    job, frame, camera = space.job, space.frame, space.camera()
    shot, given, around, ground = job.shot, job.shot.set, surroundings(space), read_ground(space)
    assert given is not None
    assert around is not None
    plate, seen, mesh = space.plate(frame, working=True), space.surface(frame, camera), space.inputs.proxy()
    settings, material = of.relight_settings(shot), space.read(SOLVE, "material", frame)
    views = captured_views(space) if space.task.cameras else []
    base, diffuse = _relit(space, "base_color", "diffuse")
    from yesnt.relight import ProxyScene

    with space.kernel():
        proxy = relight_inputs.proxy_scene(mesh, ProxyScene)
        assert proxy is not None
        surface = relight_inputs.RelightInputs(plate, seen, camera, frame, proxy).surface(material)
        files = LightFiles.of_task(space)
        light = relighting_light(files, surface, settings)
        measured = measured_sides(space, views, surface, proxy)
        subject = RelitSubject(surface, base, diffuse, proxy, measured)
        image = _image(ground, around, surface)
        behind = map_behind(files, camera, ground) if given.mode == "show" else None
        layers = lit_set(image, subject, light, around, settings, behind)
        planes = _planes(layers)
        sun = light_of_the_sun(files, surface, settings) if shot.light_groups else None
        if shot.light_groups:
            planes["set_sun"] = np.zeros_like(planes["set_added"])
        if sun is not None:
            behind = map_behind(files, camera, ground, sun=True) if given.mode == "show" else None
            (diffuse,) = _relit(space, "sun_diffuse")
            in_sun = RelitSubject(surface, base, diffuse, proxy, measured)
            planes["set_sun"] = _of_sun(lit_set(image, in_sun, sun, around, settings, behind))
    space.commit(frame, planes)


def _relit(space: Workspace[SetTask], *names: str) -> list[F32]:
    """Layers [H, W, 3] of the relit frame."""
    return [space.read(RELIGHT, name, space.frame).transpose(1, 2, 0) for name in names]


def _of_sun(layers: SetLayers) -> F32:
    """Light of the sun [3, H, W] behind the subject; a plate there holds its own, which is no part of the map's."""
    shown = 0 if layers.behind is None else layers.ratio * layers.behind
    return np.maximum(shown + layers.added, 0).astype(np.float32).transpose(2, 0, 1)


def _image(ground: Ground, around: Surroundings, surface: Surface) -> SetImage:
    from yesnt.scene.set_view import ground_image, mesh_image

    camera: Camera = surface.camera
    assert surface.frame is not None
    if around.floor is not None:
        return ground_image(ground, around.material, camera, surface.frame)
    return mesh_image(around.mesh, around.material, camera, surface.frame, np.asarray(surface.z, np.float32))


def _planes(layers: SetLayers) -> dict[str, Any]:
    """The layers [C, H, W] by channel."""
    planes = {"set_ratio": layers.ratio.transpose(2, 0, 1), "set_added": layers.added.transpose(2, 0, 1)}
    planes["holdout"] = layers.holdout[None]
    if layers.behind is not None:
        planes["set_open"] = layers.behind.transpose(2, 0, 1)
    return planes
