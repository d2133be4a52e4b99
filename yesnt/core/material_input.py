"""Sections of the job file on materials: what decomposes, passes that exist, corrections by the artist."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from yesnt.core.job_part import FIXED, Knob, Part

SCALED = "(scaled)"
"""Tag of a factor; see `FIXED`."""


class QuantityInput(Part):
    """A pass of one quantity; `channel` names its channel, `alpha` says whether it is multiplied by coverage."""

    path: str
    channel: str | None = None
    alpha: Literal["straight", "premultiplied"] = "straight"


class DecomposeInput(Part):
    """How roughness and metallic are had: a backend that is sampled, or passes already made.

    `path` holds both quantities; `roughness` or `metallic` one each, and the backend gives the other. Without `samples`
    the backend says how many members are drawn.
    """

    backend: str = "embedded"
    samples: Annotated[int, Field(ge=1, le=1024)] | None = None
    path: str | None = None
    roughness: QuantityInput | None = None
    metallic: QuantityInput | None = None
    weights: str | None = None
    accept_license: Annotated[tuple[str, ...], Field(strict=False)] = ()
    knobs: dict[str, Knob] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _once(self) -> Self:
        if self.path is not None and self.quantities:
            raise ValueError(f"path holds both quantities, and {' and '.join(self.quantities)} gives one of them again")
        return self

    @property
    def quantities(self) -> dict[str, QuantityInput]:
        """Passes of one quantity by its name."""
        given = {"roughness": self.roughness, "metallic": self.metallic}
        return {name: one for name, one in given.items() if one is not None}

    @property
    def samples_backend(self) -> bool:
        """Whether a backend is needed: passes do not give both quantities."""
        return self.path is None and len(self.quantities) < len(MATERIAL)


MATERIAL = ("roughness", "metallic")
"""The quantities of the decomposition, in the order of the stored planes."""

Share = Annotated[float, Field(ge=0, le=1)]


class Scale(Part):
    """A factor on what the decomposition found."""

    scale: Annotated[float, Field(ge=0, le=100)]


_SCALED = Discriminator(lambda value: SCALED if isinstance(value, Mapping | Scale) else FIXED)
Override = Annotated[Annotated[Share, Tag(FIXED)] | Annotated[Scale, Tag(SCALED)], _SCALED]


class MaterialInput(Part):
    """An override of roughness or metallic where a mask or a Cryptomatte covers the picture.

    `channel` names the mask's channel. Of a Cryptomatte, `names` are the objects, materials or assets, and `layer` says
    which of the file's Cryptomattes names them.
    """

    mask: str | None = None
    channel: str | None = None
    cryptomatte: str | None = None
    layer: str | None = None
    names: Annotated[tuple[str, ...], Field(strict=False)] = ()
    roughness: Override | None = None
    metallic: Override | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.mask is None) == (self.cryptomatte is None):
            raise ValueError("it needs `mask` or `cryptomatte`, and not both")
        if self.mask is not None and (self.names or self.layer is not None):
            raise ValueError("`names` and `layer` belong to `cryptomatte`")
        if self.cryptomatte is not None and self.channel is not None:
            raise ValueError("`channel` belongs to `mask`; of a Cryptomatte `names` choose")
        if self.cryptomatte is not None and not self.names:
            raise ValueError("a Cryptomatte needs `names`")
        if self.roughness is None and self.metallic is None:
            raise ValueError("it needs `roughness` or `metallic`")
        return self

    @property
    def path(self) -> str:
        """The file that says where it applies."""
        return self.mask or self.cryptomatte or ""

    @property
    def overrides(self) -> tuple[float | Scale | None, float | Scale | None]:
        """What it does to each quantity of `MATERIAL`."""
        return self.roughness, self.metallic
