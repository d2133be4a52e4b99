"""Task that relights one frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.planning import settings as of
from yesnt.planning.stages import EVIDENCE, SOLVE
from yesnt.planning.task_records import RelightTask
from yesnt.tasks.light import LightFiles, light_of_the_sun, prepared_lights
from yesnt.tasks.surroundings import surroundings
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.relight import PreparedLight, RelightSettings, RelitFrame
    from yesnt.relight.combine import Clamped
    from yesnt.tasks.relight_inputs import RelightInputs

F32 = NDArray[np.float32]


def relight(space: Workspace[RelightTask]) -> None:
    """Commits base colour, diffuse, specular [3, H, W] and shadow [1, H, W] of one frame under the new light.

    A job with light groups also gets the part of diffuse and specular that the map's sun gives.
    """
    from yesnt.relight import ProxyScene
    from yesnt.tasks import relight_inputs

    job, frame, camera = space.job, space.frame, space.camera()
    plate, seen = space.plate(frame, working=True), space.surface(frame, camera)
    material, mesh = space.read(SOLVE, "material", frame), space.inputs.proxy()
    views = space.read(EVIDENCE, "base_views", frame).transpose(1, 2, 0) if space.task.base_from_views else None
    settings, around = of.relight_settings(job.shot), surroundings(space)
    with space.kernel():
        proxy = relight_inputs.proxy_scene(mesh, ProxyScene)
        inputs = relight_inputs.RelightInputs(plate, seen, camera, frame, proxy, around)
        lights = prepared_lights(LightFiles.of_task(space), inputs.surface(material), settings)
        relit = relight_inputs.relight(inputs, material, lights, settings, base_views=views)
        planes = {
            "base_color": relit.base_color.transpose(2, 0, 1),
            "diffuse": relit.diffuse.transpose(2, 0, 1),
            "specular": relit.specular.transpose(2, 0, 1),
            "shadow": relit.shadow[None],
        }
        if job.shot.light_groups:
            sun = light_of_the_sun(LightFiles.of_task(space), inputs.surface(material), settings)
            planes |= _by_the_sun(inputs, material, sun, settings, relit)
    space.commit(frame, planes, facts=_clamped(relit.clamped))


def _by_the_sun(
    inputs: RelightInputs, material: F32, sun: PreparedLight | None, settings: RelightSettings, relit: RelitFrame
) -> dict[str, F32]:
    """What of the relit light the map's sun gives; 0 where it has none."""
    from yesnt.tasks import relight_inputs

    if sun is None:
        nothing = np.zeros((3, *material.shape[1:]), np.float32)
        return {"sun_diffuse": nothing, "sun_specular": nothing}
    lit = relight_inputs.relight(inputs, material, (sun, None), settings, relit.base_color, relit.captured)
    return {"sun_diffuse": lit.diffuse.transpose(2, 0, 1), "sun_specular": lit.specular.transpose(2, 0, 1)}


def _clamped(found: Clamped) -> dict[str, dict[str, int]]:
    """What the base colour was clamped to, for the record."""
    counts = {
        "relight: pixels brighter than a white surface, base colour clamped to 1": found.above,
        "relight: pixels darker than a black surface's reflection, base colour clamped to 0": found.below,
    }
    counts = {what: count for what, count in counts.items() if count}
    return {"clamped": counts} if counts else {}
