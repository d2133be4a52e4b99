"""Materials and normals at any point of the proxy: of the delivered picture where it shows the point, else of the mesh.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.proxy import ProxyScene
from yesnt.scene.delivered_picture import DeliveredPicture, Hits
from yesnt.scene.mesh_normals import smooth_normals
from yesnt.scene.vertex_materials import MeasuredVertices, vertex_values

F32 = NDArray[np.float32]


class Materials(NamedTuple):
    """Of R points.

    Attributes:
        base: [R, 3] base colour, 0..1.
        roughness: [R] 0..1.
        metallic: [R] 0..1.
        normal: [R, 3] unit, world, on the ray's side of the surface.
    """

    base: F32
    roughness: F32
    metallic: F32
    normal: F32


@dataclass(frozen=True)
class SubjectMaterials:
    """What is known of the proxy's surface.

    Attributes:
        picture: what the delivered camera sees of it.
        base_color: [H, W, 3] 0..1.
        measured: base colour, roughness and metallic of vertices that other cameras see; None: there are none.
    """

    picture: DeliveredPicture
    base_color: F32
    measured: MeasuredVertices | None = None

    def at(self, hits: Hits) -> Materials:
        """At points of the proxy: the picture's where it shows them, else the vertices' and the mesh's own normals."""
        mesh, weights = self.picture.mesh, hits.weights()
        shown, known = self.picture.read(self._image, hits)
        corners = mesh.faces[hits.face]
        spread = sum(w[:, None] * self._vertices[corners[:, k]] for k, w in enumerate(weights))
        own = np.concatenate([spread, smooth_normals(mesh, hits.face, weights)], axis=1)
        found = np.where(known[:, None], shown, own)
        base, roughness, metallic = np.clip(found[:, :3], 0, 1), *np.clip(found[:, 3:5], 0, 1).T
        normal = _towards_ray(mesh, hits, found[:, 5:])
        return Materials(*(np.ascontiguousarray(a, np.float32) for a in (base, roughness, metallic, normal)))

    @cached_property
    def _image(self) -> F32:
        """Base colour, roughness, metallic and normal [H, W, 8]."""
        seen = self.picture.surface
        planes = self.base_color, seen.roughness[..., None], seen.metallic[..., None], seen.normal
        return np.nan_to_num(np.concatenate([np.asarray(plane, np.float32) for plane in planes], axis=-1))

    @cached_property
    def _vertices(self) -> F32:
        """Base colour, roughness and metallic [V, 5] of the vertices."""
        mesh, seen = self.picture.mesh, self.picture.surface
        arrays = self._image[..., :5], np.asarray(seen.opacity, np.float32), np.asarray(seen.z, np.float32)
        return vertex_values((mesh.vertices, mesh.faces), (seen.camera, seen.frame), *arrays, self.measured)


def _towards_ray(mesh: ProxyScene, hits: Hits, normal: F32) -> F32:
    """Unit normals [R, 3] that face the rays: where they do not, the triangle's own, turned to the ray."""
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    flat = mesh.normals[hits.face]
    flat = np.where((flat * hits.direction).sum(axis=1, keepdims=True) > 0, -flat, flat)
    return np.where((unit * hits.direction).sum(axis=1, keepdims=True) < 0, unit, flat)
