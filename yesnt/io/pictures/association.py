"""Whether a picture's colour was multiplied by its coverage: what the job says, else what the format does."""

from __future__ import annotations

from typing import Literal

from yesnt.core.shot import PlateInput
from yesnt.io.pictures.image import ImageHeader
from yesnt.io.pictures.passes import ColorChannels

STRAIGHT, PREMULTIPLIED, BEFORE_ENCODING = "straight", "premultiplied", "premultiplied_linear"

Association = Literal["straight", "premultiplied", "premultiplied_linear"]
"""The last: multiplied before it was encoded, as Nuke writes 8-bit pictures and Blender writes them without alpha."""


def association(found: ColorChannels, spec: PlateInput) -> Association:
    """How a picture's colour and coverage go together.

    EXR is premultiplied by its standard, PNG straight by its own; a TIFF says which; other formats do not say and count
    as premultiplied. Colour without alpha in its file is straight: a matte beside it was drawn later.
    """
    if spec.alpha is not None:
        return spec.alpha
    if found.alpha is None:
        return "straight"
    return format_association(found.color[0].header)


def says_association(header: ImageHeader) -> bool:
    """Whether a file's format says how its colour and alpha go together."""
    return header.format in ("openexr", "tiff") or header.attributes.get("oiio:UnassociatedAlpha", 0) == 1


def format_association(header: ImageHeader) -> Literal["straight", "premultiplied"]:
    """What a file's format says of its own alpha."""
    straight = header.format != "openexr" and header.attributes.get("oiio:UnassociatedAlpha", 0) == 1
    return "straight" if straight else "premultiplied"
