"""Light on the set: as it is without the subject, what the subject takes from it and what it adds.

The light without the subject is the sum over lobes that relights the subject. Towards parts of the light that the
subject occludes its light is taken away, and what the subject sends out is added. Sharp lobes follow rays of their own
instead. Source: docs/method.md section 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance
from yesnt.core.set_input import MIRROR
from yesnt.relight.combine import normalise, response
from yesnt.relight.kernels import sum_lobes
from yesnt.relight.lights import PreparedLight
from yesnt.relight.settings import RelightSettings
from yesnt.scene.contact import beside_subject
from yesnt.scene.interpolate import Places, interpolated
from yesnt.scene.light_samples import light_samples
from yesnt.scene.set_brdf import set_brdf, uniform_response
from yesnt.scene.set_rays import SetRays, lobe_changes, lobe_light
from yesnt.scene.set_scene import SetScene, SetView
from yesnt.scene.sharp_lobe import FINE, SHARP, SharpLobe, specular_albedo

F32 = NDArray[np.float32]

AGREE = 0.015
"""Share of the mean radiance by which neighbouring pixels may differ that answer for those between them."""

SPACING, EDGE_SPACING = 8, 2
"""Rows and columns between the pixels that are looked at first, for smooth light and for light with an edge."""


class SetLight(NamedTuple):
    """Radiance of P pixels of the set towards the camera, all [P, 3].

    Attributes:
        open: without the subject.
        blocked: with a subject that is black: at most `open`.
        added: what the subject sends out and the set reflects.
    """

    open: F32
    blocked: F32
    added: F32


def light_set(view: SetView, light: PreparedLight, scene: SetScene, settings: RelightSettings) -> SetLight:
    """Lights the set.

    Args:
        view: P pixels.
        light: the light that relights the subject.
        scene: the subject and the set.
        settings: of relighting; `brdf` and `diffuse` are read.
    """
    pixels = view.pixels
    if not len(pixels.index):
        return SetLight(*(np.zeros((0, 3), np.float32) for _ in range(3)))
    sharp = bool(pixels.roughness[0] < SHARP)
    few = without_occlusion(view, np.arange(0, len(pixels.index), SPACING**2), light, settings)
    scale = AGREE * float(luminance(few[:, :3] + few[:, 3:]).mean())
    free = interpolated(
        pixels, lambda some: without_occlusion(view, some, light, settings), scale, 1 if sharp else SPACING
    )
    lobe = _lobe(view, light, free[:, 3:], scene, settings)
    if pixels.roughness[0] < FINE:
        free[:, 3:] = lobe_light(lobe)
    open_, change = free[:, :3] + free[:, 3:], np.zeros((len(pixels.index), 9), np.float32)
    rays, samples = SetRays(view, set_brdf(pixels, view.color, settings), scene, sharp), light_samples(light)
    near = beside_subject(view, scene.subject.mesh)
    change += interpolated(pixels, lambda some: rays.in_parts(samples.strong, some), scale, EDGE_SPACING, near)
    change += interpolated(pixels, lambda some: rays.changes(samples.weak, some), scale, SPACING, near)
    if sharp:
        spacing = 1 if pixels.roughness[0] < MIRROR else EDGE_SPACING
        change += interpolated(pixels, lambda some: lobe_changes(lobe, scene, some), scale, spacing)
    open_ = np.maximum(open_ + change[:, :3], 0)
    # An occluded part is one direction, the light without occlusion a sum over texels: they differ by a little.
    return SetLight(open_, np.clip(open_ - np.maximum(change[:, 3:6], 0), 0, open_), np.maximum(change[:, 6:], 0))


def without_occlusion(view: SetView, some: Places, light: PreparedLight, settings: RelightSettings) -> F32:
    """Diffuse and specular radiance [n, 6] of the light at pixels [n], nothing being in its way."""
    pixels = view.pixels.taken(some)
    whole, plain = slice(0, len(some)), settings.brdf == "paper"
    sums = sum_lobes(pixels.lobes(whole, settings.brdf, settings.diffuse), light, None, None, not plain)
    sums = sums if plain else normalise(sums, pixels, whole, settings.diffuse)
    weights = response(sums, pixels, settings.brdf)
    base = np.broadcast_to(view.color, (len(some), 3)).astype(np.float32)
    return np.concatenate([base * weights.diffuse, weights.specular(base)], axis=1)


def _lobe(view: SetView, light: PreparedLight, specular: F32, scene: SetScene, settings: RelightSettings) -> SharpLobe:
    albedo = specular_albedo(uniform_response(view.pixels, settings), view.color)
    return SharpLobe(view.pixels, view.parts, light.env, specular, albedo, scene.offset)
