"""The proxy mesh: occlusion by batched embree rays, and radiosity on its triangles.

Source: docs/method.md section 5 (visibility and one diffuse bounce).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yesnt.core.errors import JobError
from yesnt.relight.compiled import exact_entry, exact_kernel
from yesnt.relight.lights import Clusters
from yesnt.relight.predict import bounces_worth

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

OPEN = np.int32(-1)
"""Triangle of a ray that hits nothing."""

_LIFT = 0.02  # least cosine of a shadow ray: parts of a cluster may be above the horizon while its centre is below
_RAYS = 1 << 19  # rays per batch: 6 MB each for origins and directions


@dataclass(frozen=True)
class ProxyScene:
    """A triangle mesh in world metres, with V vertices and F faces.

    Attributes:
        vertices: [V, 3].
        faces: [F, 3] indices, counter-clockwise seen from outside.
    """

    vertices: F32
    faces: I32

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, faces: ArrayLike) -> Self:
        """Checks a mesh [V, 3], [F, 3] and converts it to float32 and int32.

        Raises:
            JobError: shapes are wrong, a vertex is not finite, an index is out of range, or there is no triangle.
        """
        points = np.ascontiguousarray(vertices, dtype=np.float32)
        triangles = np.ascontiguousarray(faces, dtype=np.int32)
        shaped = points.ndim == 2 and triangles.ndim == 2 and points.shape[1:] == triangles.shape[1:] == (3,)
        if not shaped or len(triangles) == 0 or not np.isfinite(points).all():
            raise JobError(
                "The proxy is not a triangle mesh",
                f"{points.shape}, {triangles.shape}",
                "[V, 3] finite, [F, 3]",
                "correct it",
            )
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise JobError(
                "The proxy names a vertex that it lacks", f"{triangles.max()}", f"< {len(points)}", "correct it"
            )
        return cls(points, triangles)

    @cached_property
    def centres(self) -> F32:
        """Centroids of the faces [F, 3]."""
        return self.vertices[self.faces].mean(axis=1)

    @cached_property
    def normals(self) -> F32:
        """Unit face normals [F, 3]; 0 for a degenerate face."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        cross = np.cross(b - a, c - a)
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return np.where(length > 0, cross / np.maximum(length, 1e-30), 0).astype(np.float32)

    @cached_property
    def bounds(self) -> F32:
        """Lowest and highest corner [2, 3] of the box of all vertices, widened by what rounding may move a hit."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        margin = np.float32(1e-5) * (1 + np.maximum(np.abs(low), np.abs(high)))
        return np.stack([low - margin, high + margin]).astype(np.float32)

    @cached_property
    def _scene(self) -> Any:
        """Embree's acceleration structure."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        TriangleMesh(scene, self.vertices, self.faces)
        return scene

    def first_hits(self, origins: F32, directions: F32) -> I32:
        """First triangle [R] along each ray from origins [R, 3] in directions [R, 3]; OPEN if there is none."""
        if len(origins) == 0:
            return np.zeros(0, dtype=np.int32)
        return self._scene.run(np.ascontiguousarray(origins), np.ascontiguousarray(directions), query="INTERSECT")

    def trace(self, origins: F32, directions: F32) -> Mapping[str, NDArray[np.generic]]:
        """First hits [R] of rays [R, 3], unit directions: `primID` (OPEN: none), `tfar`, m, barycentric `u`, `v`."""
        found: Mapping[str, NDArray[np.generic]] = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), query="INTERSECT", output=1
        )
        return found

    def cluster_hits(self, origins: F32, normals: F32, light: Clusters, wanted: NDArray[np.bool_] | None = None) -> I32:
        """First triangle from each point towards each light cluster.

        Clusters below a point's horizon are OPEN: they carry no light there. Rays to those at the horizon are lifted
        just above it.

        Args:
            origins: [P, 3] world metres.
            normals: [P, 3] unit, world.
            light: C clusters.
            wanted: [P, C] which rays are traced, the others being OPEN; None: all.

        Returns:
            [P, C] triangles; OPEN where the cluster is visible.
        """
        nothing = np.zeros((0, 0), dtype=np.bool_)
        count, clusters = len(origins), light.direction.shape[1]
        hits = np.full((count, clusters), OPEN, dtype=np.int32)
        step = max(1, _RAYS // clusters)
        for first in range(0, count, step):
            part = slice(first, min(first + step, count))
            asked = nothing if wanted is None else wanted[part]
            rays = cluster_rays(origins[part], normals[part], light, asked, self.bounds)
            hits[part].reshape(-1)[rays.place] = self.first_hits(rays.origins, rays.directions)
        return hits

    def gather(
        self, light: Clusters, albedo: F32, bounces: int, offset: float, error: float = 0.0, first: int | None = None
    ) -> tuple[F32, I32]:
        """Irradiance / pi of each triangle: direct light plus at most `bounces` - 1 diffuse bounces.

        Radiosity by gathering (Cohen & Greenberg 1985), with the light's clusters as directions: free of noise.

        Args:
            light: C clusters.
            albedo: [F, 3] of the triangles.
            bounces: largest number of bounces between the light and a pixel.
            offset: distance of the rays' origins from the surface, metres.
            error: allowed display error; bounces that are predicted to change less are left out (relight/predict.py).
            first: number of the first triangles from which that change is predicted; None: all.

        Returns:
            [F, 3] irradiance over pi, and [F, C] triangles that occlude the clusters (OPEN: none).
        """
        hits = self.cluster_hits(self.centres + self.normals * np.float32(offset), self.normals, light)
        cosine = np.maximum(self.normals @ light.direction, 0)
        direct = (cosine * (hits == OPEN)) @ light.energy.T / np.float32(np.pi)
        solid = cosine * light.solid_angle / np.float32(np.pi)
        hidden = float((solid * (hits != OPEN))[:first].sum(axis=1).mean())
        bounces = max(1, bounces_worth(hidden, float(albedo.mean()), error, bounces))
        arrives, sent = direct, np.zeros((len(self.faces) + 1, 3), dtype=np.float32)
        for _ in range(bounces - 1):
            sent[:-1] = albedo * arrives
            arrives = direct + np.stack([(solid * sent[hits, k]).sum(axis=1) for k in range(3)], axis=-1)
        return arrives, hits

    def paint(self, hits: I32, features: F32) -> F32:
        """Averages features of pixels on the triangles that they show.

        Args:
            hits: [P] triangle that each pixel shows, -1 for none.
            features: [P, K].

        Returns:
            [F, K]; a triangle that no pixel shows takes the features of the nearest one that is shown; if none is, the
            mean of all pixels.
        """
        from scipy.spatial import cKDTree

        seen = hits >= 0
        size, kinds = len(self.faces), features.shape[1]
        count = np.bincount(hits[seen], minlength=size)
        total = np.stack([np.bincount(hits[seen], features[seen, k], minlength=size) for k in range(kinds)], axis=-1)
        if not count.any():
            mean = features.mean(axis=0) if len(features) else np.zeros(kinds)
            return np.broadcast_to(mean, (size, kinds)).astype(np.float32)
        shown = np.flatnonzero(count)
        known = total[shown] / count[shown, None]
        _, nearest = cKDTree(self.centres[shown]).query(self.centres)
        return known[nearest].astype(np.float32)


class ClusterRays(NamedTuple):
    """R rays of points towards light clusters.

    Attributes:
        place: [R] flat index into [P, C].
        origins: [R, 3] world metres.
        directions: [R, 3] unit, world.
    """

    place: NDArray[np.int64]
    origins: F32
    directions: F32


def cluster_rays(origins: F32, normals: F32, light: Clusters, wanted: NDArray[np.bool_], bounds: F32) -> ClusterRays:
    """Rays of points [P, 3] towards the clusters above their horizon, of those that are wanted ([0, 0]: all).

    Rays that miss the box `bounds` [2, 3] of the mesh are left out: they cannot hit it.
    """
    most = len(origins) * len(light)
    rays = ClusterRays(np.empty(most, np.int64), np.empty((most, 3), np.float32), np.empty((most, 3), np.float32))
    used = _write_rays(origins, normals, light.direction, light.reach, wanted, bounds, rays)
    return ClusterRays(rays.place[:used], rays.origins[:used], rays.directions[:used])


@exact_entry
def _write_rays(origins, normals, directions, reach, wanted, bounds, rays):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Writes the rays and returns how many there are."""
    count, clusters = origins.shape[0], directions.shape[1]
    n = 0
    for p in range(count):
        for c in range(clusters):
            if wanted.shape[0] > 0 and not wanted[p, c]:
                continue
            cosine = np.float32(0)
            for k in range(3):
                cosine += normals[p, k] * directions[k, c]
            if cosine < -reach[c]:
                continue
            lift = max(np.float32(_LIFT) - cosine, np.float32(0))
            length = np.float32(0)
            for k in range(3):
                rays.directions[n, k] = directions[k, c] + lift * normals[p, k]
                length += rays.directions[n, k] ** 2
            length = np.sqrt(length)
            for k in range(3):
                rays.directions[n, k] /= length
                rays.origins[n, k] = origins[p, k]
            if _meets_box(origins, p, rays.directions, n, bounds):
                rays.place[n] = p * clusters + c
                n += 1
    return n


@exact_kernel
def _meets_box(origins, p, directions, n, bounds):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether the ray from point p along direction n meets a box [2, 3] (Kay & Kajiya 1986, slabs)."""
    near, far = np.float32(0), np.float32(np.inf)
    for k in range(3):
        one = (bounds[0, k] - origins[p, k]) / directions[n, k]
        two = (bounds[1, k] - origins[p, k]) / directions[n, k]
        if one != one or two != two:  # in the plane of a side and parallel to it
            continue
        near = max(near, min(one, two))
        far = min(far, max(one, two))
    return near <= far
