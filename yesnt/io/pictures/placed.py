"""Reads channels as the shot's pixels: placed by data and display window, refused where the pictures do not fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.core.windows import Window, place
from yesnt.io.pictures.channels import Channel
from yesnt.io.pictures.image import ImageHeader, read_channels

F32 = NDArray[np.float32]

UPRIGHT = 1
"""Value of the attribute `Orientation` of a picture whose first row is its top (Exif)."""


def read_placed(job: Job, channels: Sequence[Channel]) -> list[F32]:
    """The planes [H, W] of channels of one file, as stored, where the job's window sees them; 0 where nothing is.

    Raises:
        JobError: the picture does not fit the job's, or its pixels cannot be read.
    """
    planes: dict[tuple[int, str], F32] = {}
    for header in {channel.header.part: channel.header for channel in channels}.values():
        check_fits(job, header)
        names = list(dict.fromkeys(c.name for c in channels if c.header.part == header.part))
        for name, plane in read_channels(header, names).items():
            planes[header.part, name] = place(plane, _on_display(header), job.window)
    return [planes[channel.header.part, channel.name] for channel in channels]


def read_display(channels: Sequence[Channel]) -> list[F32]:
    """The planes of channels of one part of a picture that stands alone: its display window, 0 where nothing is stored.

    Raises:
        JobError: the picture is stored turned, or its pixels cannot be read.
    """
    header = channels[0].header
    refuse_turned(header)
    planes = read_channels(header, list(dict.fromkeys(channel.name for channel in channels)))
    return [place(planes[channel.name], header.data, header.display) for channel in channels]


def stored_where(job: Job, header: ImageHeader) -> F32:
    """1 where a picture has stored pixels and 0 around its data window, [H, W]: coverage of a picture without alpha."""
    return place(np.ones((header.height, header.width), np.float32), _on_display(header), job.window)


def check_fits(job: Job, header: ImageHeader) -> None:
    """Refuses a picture whose display window is not the shot's, or that is stored turned.

    Raises:
        JobError: as said.
    """
    if header.display.size != job.display_size:
        expected = "{}x{}".format(*job.display_size)
        said = "camera.json says" if job.raster is None else "the plate's display window says"
        raise JobError(
            f"The picture is {header.display.width}x{header.display.height}", header.path, f"{expected}, as {said}",
            "render every input at one size",
        )  # fmt: skip
    refuse_turned(header)


def refuse_turned(header: ImageHeader) -> None:
    """Refuses a picture whose first row is not its top.

    Raises:
        JobError: as said.
    """
    if header.attributes.get("Orientation", UPRIGHT) != UPRIGHT:
        raise JobError(
            f"The picture is stored turned (its attribute Orientation is {header.attributes['Orientation']})",
            header.path, "an upright picture", "turn the pixels and export it again",
        )  # fmt: skip


def _on_display(header: ImageHeader) -> Window:
    """The data window, counted from the display window's corner."""
    return header.data.moved(-header.display.left, -header.display.top)
