"""EXRs of our own: written with the OpenEXR package and read back.

OpenEXR writes the same bytes for the same picture (OpenImageIO stamps a date) and raises on a full disk (OpenImageIO
says so only in a return value). Pictures of other programs are read by `yesnt.io.pictures`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import CorruptError
from yesnt.core.windows import Window
from yesnt.io.durable import durable_path

EXR_COMPRESSIONS = ("none", "rle", "zips", "zip", "piz")
"""Lossless compressions that every EXR reader of the field opens."""


def read_planes(path: str | Path) -> dict[str, NDArray[np.floating]]:
    """Reads every channel of an EXR of our own, pixel types as stored: four times as fast as OpenImageIO."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as source:
        return {name: channel.pixels for name, channel in source.channels().items()}


def window_attributes(data: Window, display: Window) -> dict[str, Any]:
    """Attributes of both windows, for `write_exr`; OpenEXR's boxes include their last pixel."""

    def box(window: Window) -> tuple[NDArray[np.int32], ...]:
        corners = (window.left, window.top), (window.right - 1, window.bottom - 1)
        return tuple(np.array(corner, np.int32) for corner in corners)

    return {"dataWindow": box(data), "displayWindow": box(display)}


def write_exr(
    path: Path,
    channels: Mapping[str, NDArray[np.floating]],
    attributes: Mapping[str, Any] | None = None,
    compression: str = "zip",
) -> None:
    """Writes one part, atomically, and reads it back before it gets its name.

    Args:
        path: final name.
        channels: `[H, W]` planes, float16 (half) or float32 (float).
        attributes: extra header attributes; equal attributes and pixels give equal bytes.
        compression: one of `EXR_COMPRESSIONS`.

    Raises:
        ValueError: an unknown compression.
        CorruptError: what was read back is not what was written.
        OSError, RuntimeError: the disk refused.
    """
    import OpenEXR

    if compression not in EXR_COMPRESSIONS:
        raise ValueError(f"compression={compression!r} must be one of {EXR_COMPRESSIONS}")
    header = {
        "compression": getattr(OpenEXR, f"{compression.upper().replace('NONE', 'NO')}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
        **(attributes or {}),
    }
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}

    def prove(written: Path) -> None:
        back = read_planes(written)
        for name, plane in planes.items():
            if name not in back or not np.array_equal(back[name].view(np.uint8), plane.view(np.uint8)):
                raise CorruptError(
                    f"Channel {name} did not read back as written", str(path), "equal bits", "check the disk"
                )

    with (
        durable_path(path, prove) as temporary,
        OpenEXR.File(header, dict(planes)) as target,  # it replaces the values of its argument
    ):
        target.write(str(temporary))
