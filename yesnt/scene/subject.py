"""The relit subject as the set sees it: a mesh that carries the light that it sends out.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.combine import response
from yesnt.relight.frame import integrate_under
from yesnt.relight.indirect import IndirectLight, PixelRays
from yesnt.relight.lights import PreparedLight
from yesnt.relight.occlusion import Occluders
from yesnt.relight.points import Pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.surroundings import Surroundings
from yesnt.scene.delivered_picture import DeliveredPicture, Hits
from yesnt.scene.pixel_parts import RayGrid
from yesnt.scene.subject_materials import SubjectMaterials

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


class Lighting(NamedTuple):
    """What the subject is relit by.

    Attributes:
        light: the map.
        settings: of relighting.
        surroundings: the set.
    """

    light: PreparedLight
    settings: RelightSettings
    surroundings: Surroundings


@dataclass(frozen=True)
class Subject:
    """The subject in one frame.

    Attributes:
        picture: what the delivered camera sees of its mesh of F triangles.
        sent: radiance of these triangles, and of those of the set behind them in the same list.
        diffuse: [H, W, 3] straight, diffuse radiance that the delivered view shows of it.
        materials: at any point of the mesh.
        lighting: what relit it.
    """

    picture: DeliveredPicture
    sent: IndirectLight
    diffuse: F32
    materials: SubjectMaterials
    lighting: Lighting

    @property
    def mesh(self) -> ProxyScene:
        """The proxy."""
        return self.picture.mesh

    def coarse(self, face: I32, direction: F32) -> F32:
        """Radiance [R, 3] that comes from triangles [R] along rays [R, 3]; one colour a triangle."""
        aim = np.zeros(len(face), np.int32)
        rays = PixelRays(face[:, None], np.zeros((3, 1), np.float32), direction, aim)
        return np.ascontiguousarray(self.sent.towards(rays)[:, :, 0].T)

    def fine(self, hits: Hits) -> F32:
        """The same with the diffuse part of the picture where that shows the point, else of the vertices."""
        metal = self.coarse(hits.face, hits.direction) - self.sent.diffuse[hits.face]
        corners = self.mesh.faces[hits.face]
        smooth = sum(w[:, None] * self._vertices[corners[:, k]] for k, w in enumerate(hits.weights()))
        shown, known = self.picture.read(self.diffuse, hits)
        return (metal + np.where(known[:, None], shown, smooth)).astype(np.float32)

    def mirrored(self, hits: Hits, grid: RayGrid) -> F32:
        """Radiance [R, 3] as a mirror shows it: the points that the rays meet are relit, highlights included.

        Args:
            hits: where the rays meet the mesh.
            grid: of the rays; neighbours share shadow rays.
        """
        order = np.argsort(grid.place, kind="stable")
        hits, place, footprint = hits.taken(order), grid.place[order], grid.footprint[order]
        found, (light, settings, around) = self.materials.at(hits), self.lighting
        pixels = Pixels(place, grid.shape, hits.point, found.normal, -hits.direction, found.roughness, found.metallic)
        origins = (hits.point + found.normal * np.float32(settings.offset)).astype(np.float32)
        occluders = Occluders(origins, None, None, hits.face[:0], footprint[:0])
        if settings.shadows is not False:
            occluders = Occluders(origins, self.mesh, None, hits.face, footprint).within(
                around, found.normal, settings.offset
            )
        sent = self.sent if settings.bounce else None
        weights = response(integrate_under(sent, pixels, occluders, light, settings), pixels, settings.brdf)
        out = np.empty((len(order), 3), np.float32)
        out[order] = found.base * weights.diffuse + weights.specular(found.base)
        return out

    @cached_property
    def _vertices(self) -> F32:
        """Diffuse radiance [V, 3] of the vertices: the mean of their triangles."""
        count = len(self.mesh.vertices)
        corner = self.mesh.faces.reshape(-1)
        colour = np.repeat(self.sent.diffuse[: len(self.mesh.faces)], 3, axis=0)
        number = np.maximum(np.bincount(corner, minlength=count), 1)
        return np.stack([np.bincount(corner, colour[:, k], count) / number for k in range(3)], -1).astype(np.float32)
