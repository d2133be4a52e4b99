"""Every knob of the relighting stage in one frozen record, and the four named qualities."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal

from yesnt.core.errors import JobError

BaseColor = Literal["capture_removed", "plate"]
Brdf = Literal["default", "paper"]
Diffuse = Literal["lambert", "disney"]
Shadows = bool | Literal["single"]

_BOX = 1 / 3  # a pixel's share among itself and two neighbours: no film is flatter


@dataclass(frozen=True)
class RelightSettings:
    """What relighting spends and what it models.

    Attributes:
        base_color: "capture_removed" inverts the capture light out of the plate; "plate" is the paper's choice.
        brdf: "default" matches Cycles' Principled; "paper" is the plain formula of method.md section 5.
        diffuse: "lambert", or "disney": Burley's, flatter and brighter at grazing angles where it is rough.
        shadows: True: one visibility per light cluster; "single": the paper's one factor; False: none.
        texels: directions of the light that relights, dense where it is bright.
        capture_texels: directions of the capture light.
        rows: rows of the finest grid that texels are cut from.
        detail: angular size of a texel over the width of the lobe where it lies, at most; sharp lobes take finer ones.
        rays: "sparse" traces where neighbours disagree what is hidden, "every" at every pixel.
        error: display error (root mean square, 1 is white) that shared visibility and left out bounces may cost.
        clusters: visibility directions of the light that relights, at most; `error` 0 takes them all.
        capture_clusters: visibility directions of the capture light, at most.
        bounce: diffuse bounces off the proxy, at most (0: what is occluded is black).
        capture_passes: times the proxy's colour and the base colour are refined from one another.
        edges: resolve antialiased pixels into the surfaces that they mix.
        film: share of light that a pixel takes from each neighbour along an axis, where normals are of pixel centres.
        offset: metres that shadow rays start in front of the surface (a decimated proxy lies off the true one).
        march_steps: samples of a view-space march, where there is no proxy.
        thickness: metres behind the depth buffer that still occlude in the march; 0: estimated from the matte.
        engine: "numba" on the processor, "torch" on CUDA where there is one; the same results to rounding.
        tile: pixels that are shaded together; bounds memory.
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
    film: float = 0.08
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
        _require(0 <= self.film <= _BOX, "film", self.film, f"0 to {_BOX:.2f}, the mean of three")
        for name in ("error", "bounce", "capture_passes", "offset", "thickness"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "at least 0")

    @classmethod
    def from_quality(cls, quality: str, **knobs: Any) -> RelightSettings:
        """The settings of a named quality, with any knob set by name.

        Raises:
            JobError: the quality or a knob is unknown, or a value is out of range.
        """
        if quality not in QUALITIES:
            raise JobError(f"Quality '{quality}' is unknown", "quality", ", ".join(QUALITIES), "choose one")
        known = [field.name for field in fields(cls)]
        unknown = sorted(set(knobs) - set(known))
        if unknown:
            raise JobError(f"Relighting has no knob {', '.join(unknown)}", "quality", ", ".join(known), "mend the name")
        return replace(QUALITIES[quality], **knobs)


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
