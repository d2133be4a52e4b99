"""Settings of the relighting stage in one frozen record, and the four named qualities."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal

from yesnt.core.errors import JobError

BaseColor = Literal["capture_removed", "plate"]
Brdf = Literal["default", "paper"]
Diffuse = Literal["lambert", "disney"]
Shadows = bool | Literal["single"]

_BOX = 1 / 3  # weight of each neighbour in a box over three pixels: the flattest filter of that width

_FORMER = MappingProxyType({"film": "pixel_filter"})  # former name of a setting -> its name now


@dataclass(frozen=True)
class RelightSettings:
    """Cost and model of relighting (docs/method.md section 5).

    Attributes:
        base_color: "capture_removed" inverts the capture light out of the plate; "plate" is the paper's choice.
        brdf: "default" matches Cycles' Principled BSDF; "paper" is the plain formula of the paper.
        diffuse: "lambert", or "disney" (Burley 2012): on rough surfaces flatter, and brighter at grazing angles.
        shadows: True: one visibility per light cluster; "single": the paper's one factor per pixel; False: none.
        texels: directions of the light that relights, dense where it is bright.
        capture_texels: directions of the capture light.
        rows: rows of the finest lat-long grid that texels are cut from.
        detail: largest angular size of a texel over the width of the lobe there; sharp lobes read finer texels.
        rays: "sparse" traces where neighbouring pixels disagree whether light is occluded, "every" at every pixel.
        error: display error (root mean square, 1 is white) that shared visibility and omitted bounces may cost.
        clusters: largest number of visibility directions of the light that relights; `error` 0 takes them all.
        capture_clusters: largest number of visibility directions of the capture light.
        bounce: largest number of diffuse bounces off the proxy; 0: occluded directions are black.
        capture_passes: passes that refine the proxy's colour and the base colour from one another.
        edges: resolve antialiased pixels into the surfaces that they mix.
        pixel_filter: weight of each neighbour along an axis in the pixel filter; applied if the G-buffer was sampled
            at pixel centres; 0: none.
        extend: light of edge pixels is extended outward from the subject (relight/extend.py).
        offset: distance, metres, of the origins of shadow rays from the surface: a decimated proxy lies off the true
            surface.
        march_steps: samples of each view-space march, which replaces the proxy where there is none.
        thickness: depth, metres, behind the depth buffer that occludes in the march; 0: estimated from the matte.
        engine: "numba" on the processor, "torch" on CUDA if there is one; equal results to rounding.
        tile: number of pixels that are shaded together; bounds memory.
    """

    base_color: BaseColor = "capture_removed"
    brdf: Brdf = "default"
    diffuse: Diffuse = "lambert"
    shadows: Shadows = True
    texels: int = 2048
    capture_texels: int = 512
    rows: int = 256
    detail: float = 0.45
    rays: Literal["sparse", "every"] = "sparse"
    error: float = 0.0045
    clusters: int = 512
    capture_clusters: int = 128
    bounce: int = 2
    capture_passes: int = 1
    edges: bool = True
    pixel_filter: float = 0.08
    extend: bool = True
    offset: float = 0.002
    march_steps: int = 24
    thickness: float = 0.0
    engine: Literal["numba", "torch"] = "numba"
    tile: int = 8192

    def __post_init__(self) -> None:
        choices: tuple[tuple[str, tuple[Any, ...]], ...] = (
            ("base_color", ("capture_removed", "plate")),
            ("brdf", ("default", "paper")),
            ("diffuse", ("lambert", "disney") if self.brdf == "default" else ("lambert",)),
            ("shadows", (True, False, "single")),
            ("engine", ("numba", "torch")),
            ("rays", ("sparse", "every")),
        )
        for name, allowed in choices:
            _require(getattr(self, name) in allowed, name, getattr(self, name), f"one of {allowed}")
        for name in ("texels", "rows", "capture_texels", "clusters", "capture_clusters", "march_steps", "tile"):
            _require(getattr(self, name) >= 1, name, getattr(self, name), "at least 1")
        _require(self.detail > 0, "detail", self.detail, "above 0")
        _require(
            0 <= self.pixel_filter <= _BOX, "pixel_filter", self.pixel_filter, f"0 to {_BOX:.2f}, the mean of three"
        )
        for name in ("error", "bounce", "capture_passes", "offset", "thickness"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "at least 0")

    @classmethod
    def from_quality(cls, quality: str, **knobs: Any) -> RelightSettings:
        """The settings of a named quality, with any setting replaced by name.

        Raises:
            JobError: the quality or a name is unknown, or a value is out of range.
        """
        if quality not in QUALITIES:
            raise JobError(f"Quality '{quality}' is unknown", "quality", ", ".join(QUALITIES), "choose one")
        refuse_former_names(knobs)
        known = [field.name for field in fields(cls)]
        unknown = sorted(set(knobs) - set(known))
        if unknown:
            raise JobError(f"Relighting has no knob {', '.join(unknown)}", "quality", ", ".join(known), "mend the name")
        return replace(QUALITIES[quality], **knobs)


def refuse_former_names(names: Iterable[str]) -> None:
    """Raises JobError if one of the names is the former name of a setting."""
    for name in sorted(set(names) & set(_FORMER)):
        new = _FORMER[name]
        raise JobError(f"Relighting's `{name}` is now called `{new}`", f"key relight: {name}", f"`{new}`", "rename it")


def _require(good: bool, name: str, value: object, expected: str) -> None:
    if not good:
        raise JobError(f"Relighting's `{name}` cannot be {value!r}", f"quality: {name}", expected, "change it")


QUALITIES = MappingProxyType(
    {
        "draft": RelightSettings(
            texels=512, rows=128, capture_texels=128, error=0.015, clusters=64, capture_clusters=32, bounce=1
        ),
        "standard": RelightSettings(),
        "final": RelightSettings(
            texels=8192, capture_texels=2048, error=0.002, clusters=1024, capture_clusters=256, bounce=3, rays="every"
        ),
        "reference": RelightSettings(
            texels=131072,
            capture_texels=8192,
            error=0.0,
            rays="every",
            clusters=1024,
            capture_clusters=512,
            bounce=4,
            capture_passes=2,
        ),
    }
)
"""Named qualities; `standard` is the default of every entry point."""
