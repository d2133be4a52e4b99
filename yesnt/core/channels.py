"""Registry of every image that the product stores or delivers: one place for names, units and EXR channels."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Pixel = Literal["half", "float"]


@dataclass(frozen=True)
class Channel:
    """One image quantity.

    Attributes:
        name: the word used in code and as the array name in the frame store.
        components: how many planes.
        dtype: NumPy dtype in the frame store.
        unit: physical unit or "1".
        space: colour or vector space, "" where none.
        low: smallest legal value (None: unbounded).
        high: largest legal value (None: unbounded).
        exr: EXR channel names, one per component; empty if it is not delivered.
        exr_pixel: EXR pixel type.
        associated: delivered multiplied by coverage; all other layers are not.
    """

    name: str
    components: int
    dtype: str
    unit: str
    space: str
    low: float | None
    high: float | None
    exr: tuple[str, ...] = ()
    exr_pixel: Pixel = "half"
    associated: bool = False

    @property
    def colored(self) -> bool:
        """Whether its first three planes are R, G, B: they are delivered in the job's output space."""
        return [name[-1:] for name in self.exr[:3]] == ["R", "G", "B"]

    @property
    def layer(self) -> str:
        """Its layer in the EXR; "RGBA" for the unnamed one."""
        return self.exr[0].rpartition(".")[0] or "RGBA"


def _rgb(layer: str) -> tuple[str, ...]:
    return tuple(f"{layer}.{c}" for c in "RGB")


_ALL = (
    Channel("observed", 2, "float32", "1", "roughness, metallic", 0.0, 1.0),
    Channel("spread", 2, "float32", "1", "roughness, metallic", 0.0, 0.5,
            ("roughness_std.Y", "metallic_std.Y")),
    Channel("nfe", 1, "float32", "network evaluations", "", 0.0, None),
    Channel("confidence", 2, "float32", "1", "roughness, metallic", 0.0, 1.0),
    Channel("measured", 2, "float32", "1", "roughness, metallic", 0.0, 1.0),
    Channel("measured_spread", 2, "float32", "1", "roughness, metallic", 0.0, 0.5),
    Channel("views", 1, "float32", "cameras", "", 0.0, None, ("views.Y",)),
    Channel("base_views", 4, "float32", "1", "base colour in the working space, its weight", 0.0, 1.0),
    Channel("corrected", 2, "float32", "1", "roughness, metallic", 0.0, 1.0),
    Channel("corrected_spread", 2, "float32", "1", "roughness, metallic", 0.0, 0.5),
    Channel("certain", 2, "float32", "1", "roughness, metallic", 0.0, 1.0),
    Channel("flow", 2, "float32", "pixels", "(dx, dy), t -> t+1", None, None),
    Channel("validity", 1, "float32", "1", "", 0.0, 1.0),
    Channel("material", 2, "float32", "1", "roughness, metallic", 0.0, 1.0, ("roughness.Y", "metallic.Y")),
    Channel("base_color", 3, "float32", "1", "working space", 0.0, 1.0, _rgb("base_color")),
    Channel("diffuse", 3, "float32", "radiance", "working space", 0.0, None, _rgb("diffuse"), associated=True),
    Channel("specular", 3, "float32", "radiance", "working space", 0.0, None, _rgb("specular"), associated=True),
    Channel("shadow", 1, "float32", "1", "", 0.0, 1.0, ("shadow.Y",)),
    Channel("sun_diffuse", 3, "float32", "radiance", "working space", 0.0, None),
    Channel("sun_specular", 3, "float32", "radiance", "working space", 0.0, None),
    Channel("set_open", 3, "float32", "radiance", "working space", 0.0, None),
    Channel("set_ratio", 3, "float32", "1", "working space", 0.0, 1.0),
    Channel("set_added", 3, "float32", "radiance", "working space", None, None),
    Channel("set_sun", 3, "float32", "radiance", "working space", 0.0, None),
    Channel("shadow_set", 1, "float32", "1", "", 0.0, 1.0, ("shadow_set.Y",)),
    Channel("reflection_set", 3, "float32", "radiance", "working space", None, None, _rgb("reflection_set")),
    Channel("env", 3, "float32", "radiance", "working space", None, None, _rgb("env")),
    Channel("holdout", 1, "float32", "1", "", 0.0, 1.0, ("holdout.Y",)),
    Channel("front", 3, "float32", "radiance", "working space", 0.0, None, _rgb("front"), associated=True),
    Channel("composite", 4, "float32", "radiance", "working space", 0.0, None, ("R", "G", "B", "A"), associated=True),
    Channel("light_sun", 3, "float32", "radiance", "working space", None, None, _rgb("light_sun"), associated=True),
    Channel("light_rest", 3, "float32", "radiance", "working space", None, None, _rgb("light_rest"), associated=True),
    Channel("relit", 4, "float32", "radiance", "working space", 0.0, None,
            ("relit.R", "relit.G", "relit.B", "relit.A"), associated=True),
    Channel("normal", 3, "float32", "1", "world", -1.0, 1.0, ("N.X", "N.Y", "N.Z")),
    Channel("z", 1, "float32", "m", "camera +z", 0.0, None, ("depth.Z",), "float"),
)  # fmt: skip

CHANNELS = MappingProxyType({channel.name: channel for channel in _ALL})
"""Every channel by name."""

STORED = (
    "observed",
    "spread",
    "nfe",
    "measured",
    "measured_spread",
    "views",
    "base_views",
    "corrected",
    "corrected_spread",
    "certain",
    "confidence",
    "flow",
    "validity",
    "material",
    "base_color",
    "diffuse",
    "specular",
    "shadow",
    "sun_diffuse",
    "sun_specular",
    "set_open",
    "set_ratio",
    "set_added",
    "set_sun",
    "holdout",
    "front",
)
"""Channels that live in the frame store."""

OF_THE_SUN = ("sun_diffuse", "sun_specular", "set_sun")
"""Channels that live there only where the job asks for light groups: light of the map's sun alone."""

DELIVERED = ("composite", "relit", "diffuse", "specular", "shadow", "material", "spread", "normal", "z")
"""Channels that the output EXR carries, in file order."""

MEASURED = ("views",)
"""Channels that it carries after these where the capture's cameras measure the materials."""

SET_LAYERS = ("shadow_set", "reflection_set", "env", "holdout", "front")
"""Channels that it carries after these where the job has a set."""

ON_REQUEST = ("base_color", "light_sun", "light_rest")
"""Channels that it carries after these where `exr.layers` names them."""
