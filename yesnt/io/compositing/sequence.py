"""What a compositing script must know of the EXR sequence beside it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LayerSequence:
    """An EXR sequence NAME.####.exr with the layers of a set, of light groups, or of both.

    Attributes:
        name: NAME.
        frames: first and last.
        size: columns and rows of the display window.
        aspect: width of a pixel over its height.
        front: whether what is in front of the subject is a layer of its own.
        set: whether there are layers of a set.
        groups: whether there are `light_sun` and `light_rest`.
    """

    name: str
    frames: tuple[int, int]
    size: tuple[int, int]
    aspect: float
    front: bool
    set: bool = True
    groups: bool = False
