"""Reads a pass that holds one quantity of the material."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.material_input import QuantityInput
from yesnt.core.shot import Job
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.channels import Channel, channels_of, last_word, named
from yesnt.io.pictures.image import read_headers
from yesnt.io.pictures.passes import Headers, find_scalar
from yesnt.io.pictures.placed import read_placed

F32 = NDArray[np.float32]


def single_pass(job: Job, headers: Headers, name: str) -> F32:
    """A pass that has a file of its own, [H, W] raw data; models that paint it in three channels mean their average."""
    return _averaged(read_placed(job, single_channels(headers, name)))


def single_channels(headers: Headers, name: str) -> tuple[Channel, ...]:
    """The channel of such a pass; three where it is painted in colour.

    Raises:
        JobError: absent or ambiguous.
    """
    alone = {channel.name: channel for channel in channels_of(headers, None, "decompose")}
    called_so = [c for c in alone.values() if name in (last_word(c.part_layer), c.component.lower())]
    if not called_so and "Y" in alone:
        return (alone["Y"],)
    if not called_so and {"R", "G", "B"} <= set(alone) <= {"R", "G", "B", "A"}:  # beside other layers it is the beauty
        return alone["R"], alone["G"], alone["B"]
    return (find_scalar(headers, name, "decompose"),)


def quantity_channels(headers: Headers, name: str, spec: QuantityInput) -> tuple[Channel, ...]:
    """The channels of a pass of one quantity: the one that the job names, or the obvious ones.

    Raises:
        JobError: absent or ambiguous.
    """
    key = f"decompose.{name}"
    if spec.channel is None:
        return single_channels(headers, name)
    return (named(channels_of(headers, None, key), spec.channel, key),)


def _averaged(planes: Sequence[F32]) -> F32:
    return planes[0] if len(planes) == 1 else np.stack(planes).mean(0).astype(np.float32)


def read_quantity(job: Job, name: str, spec: QuantityInput, frame: int, matte: F32) -> tuple[F32, int]:
    """A pass of one quantity [H, W] in [0, 1], and how many of its values inside the matte were outside that.

    Args:
        job: the job.
        name: the quantity.
        spec: file, channel, and whether values are multiplied by coverage.
        frame: frame number.
        matte: [H, W] coverage; outside it the pass is not looked at.

    Raises:
        JobError: it cannot be read, or is NaN or infinite inside the matte.
    """
    key = f"decompose.{name}"
    headers = read_headers(frame_path(job.root, spec.path, frame))
    plane = _averaged(read_placed(job, quantity_channels(headers, name, spec)))
    inside = matte > 0
    if spec.alpha == "premultiplied":
        plane = np.where(inside, plane / np.where(inside, matte, 1), 0).astype(np.float32)
    refuse_not_finite(plane, inside, headers[0].path, key)
    refuse_coded(plane[inside], headers[0].path, name)
    plane = np.where(inside, plane, 0)
    return np.clip(plane, 0, 1), int(((plane < 0) | (plane > 1)).sum())


def refuse_not_finite(plane: F32, inside: NDArray[np.bool_], path: str, what: str) -> None:
    """Refuses a plane [H, W] that is not finite inside the matte.

    Raises:
        JobError: as said.
    """
    bad = ~np.isfinite(plane) & inside
    if bad.any():
        y, x = (int(v[0]) for v in np.nonzero(bad))
        raise JobError(
            f"{int(bad.sum())} values inside the matte are NaN or Inf in {what}", f"{path}, first at x={x} y={y}",
            "finite numbers", "mend this picture",
        )  # fmt: skip


def refuse_coded(values: F32, path: str, what: str) -> None:
    """Refuses materials in 0 to 255 and the like, which would all be read as 1.

    Args:
        values: of one material inside the matte, as stored, of any shape.
        path: of the picture.
        what: names the material.

    Raises:
        JobError: more than half of them lie outside [0, 1].
    """
    outside = float(((values < 0) | (values > 1)).mean()) if values.size else 0.0
    if outside > 0.5:
        raise JobError(
            f"{outside:.0%} of {what} inside the matte lie outside 0 to 1 (median {np.median(values):g})",
            path, "Disney's roughness and metallic in 0 to 1", "divide by 255, or export it again",
        )  # fmt: skip
