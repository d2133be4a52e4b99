"""What a plate's header says of the shot: windows, pixel aspect ratio, frame rate, metadata that is carried on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

from yesnt.core.shot import PlateInput
from yesnt.core.windows import Window
from yesnt.io.pictures.association import PREMULTIPLIED, association
from yesnt.io.pictures.image import ImageHeader, read_headers
from yesnt.io.pictures.passes import find_color

CARRIED = MappingProxyType({
    "framesPerSecond": Fraction, "timeCode": object, "keyCode": object, "reelName": str, "imageCounter": int,
    "expTime": float, "aperture": float, "isoSpeed": float, "focus": float,
})  # fmt: skip
"""Attributes of EXR that the delivered files carry on, and the types of their values: they say when and how a frame was
shot, and stay true when it is relit."""

_OTHER_NAMES = MappingProxyType({
    "timeCode": "smpte:TimeCode", "keyCode": "smpte:KeyCode", "expTime": "ExposureTime", "aperture": "FNumber",
})  # fmt: skip
"""What OpenImageIO calls them."""

MOST_FRAMES_PER_SECOND = 1000


@dataclass(frozen=True)
class PlateHeader:
    """One plate.

    Attributes:
        data: window of the stored pixels.
        display: window of the picture that is meant.
        aspect: width of a pixel over its height.
        rate: frames per second as numerator and denominator; None: it does not say.
        metadata: names among `CARRIED` that it has.
        reading: format and association where they are not premultiplied linear EXR; else "".
    """

    data: Window
    display: Window
    aspect: float
    rate: tuple[int, int] | None
    metadata: tuple[str, ...]
    reading: str

    def as_json(self) -> list[Any]:
        """A plain document."""
        windows = [[w.left, w.top, w.width, w.height] for w in (self.data, self.display)]
        return [*windows, self.aspect, self.rate, self.metadata, self.reading]

    @classmethod
    def from_json(cls, document: list[Any]) -> PlateHeader:
        """The plate of `as_json`."""
        data, display, aspect, rate, metadata, reading = document
        return cls(Window(*data), Window(*display), aspect, tuple(rate) if rate else None, tuple(metadata), reading)


def read_plate_header(path: Path, spec: PlateInput) -> PlateHeader:
    """Reads the header of a plate.

    Raises:
        JobError: the file cannot be opened, or its colour is not found.
    """
    found = find_color(read_headers(path), spec, "plate")
    header, how = found.color[0].header, association(found, spec)
    usual = header.format == "openexr" and spec.colorspace == "lin_rec709"
    plain = usual and (found.alpha is None or how == PREMULTIPLIED)
    return PlateHeader(
        header.data, header.display, _aspect(header), _rate(header), _metadata(header),
        "" if plain else f"{header.format} {how}",
    )  # fmt: skip


def carried_attributes(path: Path, part: int, names: tuple[str, ...]) -> Mapping[str, Any]:
    """Values of a plate's attributes as the OpenEXR package takes them; those of another type are left out."""
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as source:
        stored = dict(source.parts[part].header)  # the package empties its own
    return {name: stored[name] for name in names if name in stored and isinstance(stored[name], _type_of(name))}


def _type_of(name: str) -> Any:
    import OpenEXR

    return {"timeCode": OpenEXR.TimeCode, "keyCode": OpenEXR.KeyCode}.get(name, CARRIED[name])


def _metadata(header: ImageHeader) -> tuple[str, ...]:
    if header.format != "openexr":
        return ()
    return tuple(name for name in CARRIED if _OTHER_NAMES.get(name, name) in header.attributes)


def _aspect(header: ImageHeader) -> float:
    """Pixel aspect ratio; 1 where a format has none, or a value that no picture has (DPX is often left unset)."""
    value = header.attributes.get("PixelAspectRatio", 1.0)
    known = isinstance(value, int | float) and math.isfinite(value) and value > 0
    return float(value) if known else 1.0


def _rate(header: ImageHeader) -> tuple[int, int] | None:
    """Frames per second, where they are a number that a video can have."""
    value = header.attributes.get("framesPerSecond")
    if not isinstance(value, tuple) or len(value) != 2 or min(value) <= 0:
        return None
    rate = Fraction(*value)
    return (rate.numerator, rate.denominator) if rate <= MOST_FRAMES_PER_SECOND else None
