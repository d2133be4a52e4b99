"""Which terms of the model a shot needs, and why; shown by the command `plan` before anything runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yesnt.core.color import luminance
from yesnt.relight.brdf import alpha_ggx
from yesnt.relight.indirect import LEVELS, nearest_level
from yesnt.relight.lights import PreparedLight
from yesnt.relight.pixel_filter import read_at_centres
from yesnt.relight.settings import RelightSettings
from yesnt.relight.texel_lod import least_bearable

_SUN_SHARE = 0.02  # share of the light in one texel from which it is a source with a shadow of its own
_TRACE = 1 / 512  # metallic below the precision of an 8-bit pass
_EVEN = 0.02  # relative spread of radiance below which a map counts as uniform


@dataclass(frozen=True)
class Requirement:
    """Whether one term of the model is computed.

    Attributes:
        term: its name.
        modelled: whether it is computed.
        reason: one clause.
    """

    term: str
    modelled: bool
    reason: str


@dataclass(frozen=True)
class SceneFacts:
    """Facts about a shot that are known before it runs; None where unknown.

    Attributes:
        light: the map that relights.
        capture: the capture light.
        proxy: whether the shot has a proxy mesh.
        roughness: smallest and largest value of the material passes.
        metallic: smallest and largest value of the material passes.
        short: share of the first frame's normals that are averages of several directions.
    """

    light: PreparedLight | None = None
    capture: PreparedLight | None = None
    proxy: bool = False
    roughness: tuple[float, float] | None = None
    metallic: tuple[float, float] | None = None
    short: float | None = None


def requirements(facts: SceneFacts, settings: RelightSettings) -> tuple[Requirement, ...]:
    """Lists every term of the model, modelled or left out, with the reason."""
    return (
        _metal(facts, settings),
        _levels(facts, settings),
        _sharp(facts, settings),
        _sun(facts),
        _shadow(facts, settings),
        _bounce(facts, settings),
        _capture(facts, settings),
        _pixel_filter(facts, settings),
    )


def _metal(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """The metallic lobe."""
    name = "metallic lobe"
    if settings.brdf == "paper":
        return Requirement(name, True, "the paper's BRDF has one lobe for metals and dielectrics")
    if facts.metallic is not None and facts.metallic[1] < _TRACE:
        return Requirement(name, False, "no pixel is metallic")
    return Requirement(name, True, "computed for the pixels that are metallic, skipped for the others")


def _levels(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """Levels of the filtered map that metal mirrors in metal."""
    name = "map filtered for metal in metal"
    if settings.bounce == 0 or settings.shadows is not True or not facts.proxy:
        return Requirement(name, False, "there is no indirect radiance of a proxy")
    if facts.metallic is not None and facts.metallic[1] < _TRACE:
        return Requirement(name, False, "no pixel is metallic")
    if facts.roughness is None:
        return Requirement(name, True, f"at most {len(LEVELS)} levels, those that the metal's roughness asks for")
    low, high = facts.roughness
    first, last = nearest_level(np.array([low, high], dtype=np.float32))
    if first == last:
        return Requirement(name, True, f"one level: roughness is {low:.2f} to {high:.2f}")
    return Requirement(name, True, f"at most {last - first + 1} levels: roughness is {low:.2f} to {high:.2f}")


def _sharp(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """Texels finer than level 0."""
    name = "fine texels for sharp lobes"
    if facts.light is None or facts.roughness is None:
        return Requirement(name, True, "each pixel reads those that are small compared with its lobe")
    alpha = float(alpha_ggx(np.array(facts.roughness[0])))
    finest, all_ = facts.light.texels.finest(least_bearable(settings.detail, alpha)), len(facts.light.texels.start)
    if finest == 0:
        return Requirement(name, False, f"no roughness is below {facts.roughness[0]:.2f}: no lobe asks for them")
    return Requirement(name, True, f"{finest} of {all_ - 1} finer sizes: roughness begins at {facts.roughness[0]:.2f}")


def _sun(facts: SceneFacts) -> Requirement:
    """A texel that is a light source of its own."""
    name = "sun"
    if facts.light is None:
        return Requirement(name, True, "the map is not known yet")
    light = facts.light
    power = luminance(light.texels.energy.T.astype(np.float64))
    share = float(power.max() / max(power.sum(), 1e-30))
    if share < _SUN_SHARE:
        return Requirement(name, False, f"the brightest texel holds {100 * share:.1f} % of the light")
    return Requirement(name, True, f"one texel holds {100 * share:.0f} % of the light: it has its own shadow")


def _shadow(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """Visibility of the light."""
    name = "shadows"
    if settings.shadows is False:
        return Requirement(name, False, "switched off by `shadows`")
    if settings.shadows == "single":
        return Requirement(name, True, "the paper's one factor, marched against z")
    if not facts.proxy:
        return Requirement(name, True, "marched against z: the shot has no proxy mesh")
    if facts.light is None:
        return Requirement(name, True, f"at most {settings.clusters} rays a pixel to the proxy")
    light, bound = facts.light, f", {settings.error:g} allowed" if settings.error else ""
    return Requirement(
        name,
        True,
        f"{len(light.clusters)} rays a pixel to the proxy, {shadow_blur(light):.1f} degrees of light each on average: "
        f"predicted display error {light.shadow_error:.4f}{bound}",
    )


def _bounce(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """Whether indirect radiance of the proxy is modelled, and why."""
    name = "bounce"
    if settings.bounce == 0 or settings.shadows is not True:
        return Requirement(name, False, "switched off")
    if not facts.proxy:
        return Requirement(name, False, "the shot has no proxy mesh to bounce off")
    most = "" if settings.error == 0 else ", fewer on frames where they are predicted to be worth too little"
    return Requirement(name, True, f"{settings.bounce} diffuse bounce(s) off the proxy{most}")


def _capture(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """Removal of the capture light."""
    name = "capture light"
    if settings.base_color == "plate":
        return Requirement(name, False, "the plate is used as base colour, as in the paper")
    if facts.capture is None:
        return Requirement(name, True, "taken out of the plate")
    radiance = luminance(facts.capture.env.radiance.astype(np.float64))
    even = float(radiance.std() / max(radiance.mean(), 1e-30)) < _EVEN
    return Requirement(name, True, "uniform: only occlusion and albedo matter" if even else "taken out of the plate")


def _pixel_filter(facts: SceneFacts, settings: RelightSettings) -> Requirement:
    """The pixel filter."""
    name = "pixel filter"
    if settings.pixel_filter == 0:
        return Requirement(name, False, "switched off by `pixel_filter`")
    if facts.short is None:
        return Requirement(name, True, "where normals are of unit length: read at pixel centres")
    found = f"{100 * facts.short:.1f} % of the first frame's normals are averages"
    if read_at_centres(facts.short):
        return Requirement(name, True, f"{found}: light is computed at pixel centres and averaged like the plate")
    return Requirement(name, False, f"{found}: the G-buffer has been through the filter")


def shadow_blur(light: PreparedLight) -> float:
    """Mean angular distance, degrees, of light from the direction of its cluster: the error of a shadow edge."""
    direction, power = light.texels.direction, light.texels.energy.sum(axis=0, dtype=np.float64)
    cosine = (direction * light.clusters.direction[:, light.texels.owner(0)]).sum(axis=0)
    angle = np.arccos(np.clip(cosine, -1, 1))
    return float(np.degrees((power * angle).sum() / max(power.sum(), 1e-30)))
