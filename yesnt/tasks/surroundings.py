"""The set of a job as the kernels take it; the relight task and the task of the set share it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from yesnt.io.mesh import read_mesh
from yesnt.tasks.ground import read_ground
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.relight.surroundings import Surroundings


def surroundings(space: Workspace[Any]) -> Surroundings | None:
    """The set around the subject; None for a job without one."""
    from yesnt.relight import ProxyScene
    from yesnt.relight.surroundings import SetMaterial, Surroundings

    given = space.job.shot.built_in_set
    if given is None:
        return None
    material = SetMaterial(np.array(given.color, np.float32), given.roughness, given.metallic)
    if given.mesh is not None:
        path = space.inputs.path("mesh", space.frame)
        mesh = read_mesh(path, "The set's mesh")
        space.inputs.prove("mesh", space.frame)
        return Surroundings(ProxyScene.from_arrays(mesh.vertices, mesh.faces), material)
    ground = read_ground(space)
    return Surroundings(ProxyScene.from_arrays(*ground.mesh()), material, ground.height)
