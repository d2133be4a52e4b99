"""Rays from pixels of the set: towards samples of the light, and along sharp lobes.

Each function returns sums [n, 9] for n pixels: the change of the radiance by the set itself (a mesh occludes and lights
itself), the radiance that the subject takes away, and that which it adds; R, G, B each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.lights import Clusters
from yesnt.relight.proxy import OPEN, cluster_rays
from yesnt.scene.delivered_picture import hits_of
from yesnt.scene.interpolate import Places
from yesnt.scene.pixel_parts import PARTS
from yesnt.scene.set_brdf import SetBrdf
from yesnt.scene.set_kernels import SampleHits, sum_samples
from yesnt.scene.set_scene import SetScene, SetView
from yesnt.scene.sharp_lobe import RAYS, SharpLobe

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_PAIRS = 1 << 20  # pairs of a pixel and a direction that are looked at together; bounds memory


class SetRays(NamedTuple):
    """Rays from pixels of the set towards samples of the light.

    Attributes:
        view: the pixels.
        brdf: their BRDF.
        scene: what rays may hit.
        sharp: whether the specular lobe is left to `lobe_changes`.
    """

    view: SetView
    brdf: SetBrdf
    scene: SetScene
    sharp: bool

    def changes(self, samples: Clusters, some: Places) -> F32:
        """Sums over samples of the light for pixels [n], from the middles of the pixels."""
        return self._from(samples, some, self.view.pixels.position[some])

    def in_parts(self, samples: Clusters, some: Places) -> F32:
        """The same with every fourth sample from each part of the pixels, so that edges of shadows are soft."""
        total = np.zeros((len(some), 9), np.float32)
        for part in range(len(PARTS)):
            origin, _ = self.view.parts.seen(self.view.pixels, part, some)
            total += self._from(_every(samples, part), some, origin)
        return total

    def _from(self, samples: Clusters, some: Places, origin: F32) -> F32:
        found, step = [np.zeros((0, 9), np.float32)], max(1, _PAIRS // max(len(samples), 1))
        for first in range(0, len(some), step):
            band = slice(first, first + step)
            found.append(self._band(samples, some[band], origin[band]))
        return np.concatenate(found)

    def _band(self, samples: Clusters, part: Places, place: F32) -> F32:
        scene, nothing = self.scene, np.zeros((0, 0), dtype=np.bool_)
        normal = self.view.pixels.normal[part]
        origin = (place + np.float32(scene.offset) * normal).astype(np.float32)
        rays = cluster_rays(origin, normal, samples, nothing, scene.joined.bounds)
        face, own = _first(scene, rays.origins, rays.directions)
        hit = np.flatnonzero((face != OPEN) | (own != OPEN))
        pixel, sample = np.divmod(rays.place[hit], max(len(samples), 1))
        met = _met(scene, face[hit], own[hit], rays.directions[hit])
        hits, out = SampleHits(pixel, part[pixel], sample, *met), np.zeros((len(part), 9))
        sum_samples(hits, self.brdf, (samples.direction, samples.energy, samples.solid_angle), self.sharp, out)
        return out.astype(np.float32)


def _every(samples: Clusters, part: int) -> Clusters:
    """Every fourth sample, beginning with one of the first four."""
    columns = samples.direction, samples.energy, samples.solid_angle, samples.reach, samples.spread
    return Clusters(*(np.ascontiguousarray(column[..., part :: len(PARTS)]) for column in columns))


def lobe_light(lobe: SharpLobe) -> F32:
    """Specular radiance [P, 3] of the map along the rays of a sharp lobe, nothing being in their way."""
    found, step = [np.zeros((0, 3), np.float32)], _PAIRS // (4 * RAYS)
    for first in range(0, len(lobe.pixels.index), step):
        part = np.arange(first, min(first + step, len(lobe.pixels.index)))
        rays = lobe.rays(part)
        pixel = np.repeat(np.arange(len(part)), len(rays.weight) // len(part))
        light = _sum(len(part), pixel, rays.light * rays.weight[:, None])
        found.append(lobe.albedo[part] * light / _sum(len(part), pixel, rays.weight[:, None]))
    return np.concatenate(found).astype(np.float32)


def lobe_changes(lobe: SharpLobe, scene: SetScene, some: Places) -> F32:
    """The same along the rays of a sharp lobe, for pixels [n]."""
    found = [np.zeros((0, 9), np.float32)]
    for first in range(0, len(some), _PAIRS // (4 * RAYS)):
        part = some[first : first + _PAIRS // (4 * RAYS)]
        rays = lobe.rays(part)
        count = len(rays.weight) // max(len(part), 1)
        pixel = np.repeat(np.arange(len(part)), count)
        share = rays.weight[:, None] / _sum(len(part), pixel, rays.weight[:, None])[pixel]
        weighed = rays.light * rays.weight[:, None]
        before = weighed / _sum(len(part), pixel, weighed)[pixel] * lobe.specular[part][pixel]
        traced = np.flatnonzero(rays.weight > 0)
        face, own = _first(scene, rays.origin[traced], rays.direction[traced])
        hit = np.flatnonzero((face != OPEN) | (own != OPEN))
        ray = traced[hit]
        weight = share[ray] * lobe.albedo[part][pixel[ray]]
        met = _met(scene, face[hit], own[hit], rays.direction[ray])
        met = _seen(lobe, scene, met, _Rays(part[pixel[ray]], ray % count, rays.origin[ray], rays.direction[ray]))
        found.append(totals(len(part), pixel[ray], before[ray], weight, met))
    return np.concatenate(found)


def _sum(count: int, pixel: NDArray[np.intp], values: F32) -> F32:
    """Sums [count, K] of values [R, K] by pixel, at least 1e-30."""
    total = np.stack([np.bincount(pixel, values[:, k], count) for k in range(values.shape[1])], axis=-1)
    return np.maximum(total, 1e-30).astype(np.float32)


def _first(scene: SetScene, origin: F32, direction: F32) -> tuple[I32, I32]:
    """First triangle [R] of subject and set along each ray, and of the set alone (OPEN for a plane)."""
    face = scene.joined.first_hits(origin, direction)
    if scene.surroundings is None:
        return face, np.full_like(face, OPEN)
    return face, scene.surroundings.mesh.first_hits(origin, direction)


class Met(NamedTuple):
    """What R rays meet.

    Attributes:
        subject: [R] whether it is the subject.
        beside: [R] whether the set would be met without the subject.
        from_subject: [R, 3] radiance that the subject sends back along the ray, 0 where it is not met.
        from_set: [R, 3] radiance of the set, 0 where it would not be met.
    """

    subject: NDArray[np.bool_]
    beside: NDArray[np.bool_]
    from_subject: F32
    from_set: F32


def _met(scene: SetScene, face: I32, own: I32, direction: F32) -> Met:
    """What rays meet, one colour a triangle."""
    subject, count = scene.subject, np.int32(len(scene.subject.mesh.faces))
    meets, beside = (face != OPEN) & (face < count), own != OPEN
    from_subject = subject.coarse(np.where(meets, face, OPEN), direction)
    if scene.surroundings is None:
        return Met(meets, beside, from_subject, np.zeros_like(from_subject))
    return Met(meets, beside, from_subject, subject.coarse(np.where(beside, own + count, OPEN), direction))


class _Rays(NamedTuple):
    """R rays of a sharp lobe.

    Attributes:
        pixel: [R] number of the pixel.
        number: [R] of the ray among those of its pixel; of a mirror the part that it comes from.
        origin: [R, 3] world metres.
        direction: [R, 3] unit, world.
    """

    pixel: Places
    number: Places
    origin: F32
    direction: F32


def _seen(lobe: SharpLobe, scene: SetScene, met: Met, rays: _Rays) -> Met:
    """The same with the subject as a sharp lobe sees it: relit in a mirror, else with its colours in detail."""
    at = np.flatnonzero(met.subject)
    hits, known = hits_of(scene.subject.mesh, rays.origin[at], rays.direction[at])
    at = at[known]
    if not len(at):
        return met
    if not lobe.is_mirror:
        met.from_subject[at] = scene.subject.fine(hits)
        return met
    start = rays.origin[at]
    travelled = np.linalg.norm(start - lobe.parts.eye, axis=1) + np.linalg.norm(hits.point - start, axis=1)
    grid = lobe.parts.grid(lobe.pixels, rays.pixel[at], rays.number[at], travelled)
    met.from_subject[at] = scene.subject.mirrored(hits, grid)
    return met


def totals(count: int, pixel: NDArray[np.intp], before: F32, weight: F32, met: Met) -> F32:
    """Sums [count, 9] over rays [R] by pixel: `before` is the light without occlusion, `weight` that of radiance."""
    subject, beside, own = met.subject[:, None], met.beside[:, None], weight * met.from_set
    change = np.where(beside, own - before, 0)
    lost = np.where(subject, np.where(beside, own, before), 0)
    values = np.concatenate([change, lost, weight * met.from_subject], axis=1)
    return np.stack([np.bincount(pixel, values[:, k], count) for k in range(9)], axis=-1).astype(np.float32)
