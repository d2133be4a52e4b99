"""What the capture's cameras say of the sides of the subject that the delivered view does not show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.planning import settings as of
from yesnt.planning.task_records import SidesTask
from yesnt.tasks.light import LightFiles, captured_light
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.decompose.evidence.records import View
    from yesnt.decompose.evidence.sides import SurfacePoints
    from yesnt.relight import ProxyScene, Surface
    from yesnt.scene.vertex_materials import MeasuredVertices

F32 = NDArray[np.float32]


def measured_sides(
    space: Workspace[SidesTask], views: list[View], surface: Surface, proxy: ProxyScene
) -> MeasuredVertices | None:
    """Base colour, roughness and metallic [V, 5] of the vertices that the delivered view does not show, as measured.

    Args:
        space: of the task.
        views: pictures of its cameras; none: nothing is measured.
        surface: what the delivered view shows, with the materials of the store.
        proxy: mesh of the subject, V vertices.
    """
    from yesnt.decompose.evidence.sides import Cameras, measure_points
    from yesnt.scene.vertex_materials import MeasuredVertices

    if not views:
        return None
    unseen, points = _unseen_points(surface, proxy)
    settings, evidence = of.relight_settings(space.job.shot), of.evidence_settings(space.job.shot)
    light = captured_light(LightFiles.of_task(space), surface, settings)
    found, known = measure_points(points, Cameras(views, proxy, light), settings, evidence)
    values, measured = np.zeros((len(proxy.vertices), 5), np.float32), np.zeros(len(proxy.vertices), np.bool_)
    values[unseen], measured[unseen] = found, known
    return MeasuredVertices(values, measured)


def _unseen_points(surface: Surface, proxy: ProxyScene) -> tuple[NDArray[np.intp], SurfacePoints]:
    """Numbers of the vertices that the view does not show, and these as points; the nearest seen are their prior."""
    from yesnt.decompose.evidence.sides import SurfacePoints
    from yesnt.scene.mesh_normals import vertex_normals
    from yesnt.scene.vertex_materials import shown_vertices, vertex_values

    opacity, z = (np.asarray(a, np.float32) for a in (surface.opacity, surface.z))
    view, mesh = (surface.camera, surface.frame), (proxy.vertices, proxy.faces)
    materials = np.stack([np.asarray(a, np.float32) for a in (surface.roughness, surface.metallic)], axis=-1)
    unseen = np.flatnonzero(~shown_vertices(proxy.vertices, view, opacity, z))
    number = np.full(len(proxy.vertices), -1)
    number[unseen] = np.arange(len(unseen))
    edges = number[np.concatenate([proxy.faces[:, [0, 1]], proxy.faces[:, [1, 2]], proxy.faces[:, [2, 0]]])]
    edges = np.unique(np.sort(edges[(edges >= 0).all(axis=1)], axis=1), axis=0)
    prior = np.clip(vertex_values(mesh, view, materials, opacity, z)[unseen], 0, 1)
    return unseen, SurfacePoints(proxy.vertices[unseen], vertex_normals(proxy)[unseen], prior, edges)
