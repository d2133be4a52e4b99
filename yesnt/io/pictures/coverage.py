"""Reads coverage from a file of its own: a matte or a mask."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.shot import Job
from yesnt.io.pictures.channels import ALPHA, RED_GREEN_BLUE, Channel, channels_of, layer_groups
from yesnt.io.pictures.passes import Headers, find_matte, labels
from yesnt.io.pictures.placed import read_placed

F32 = NDArray[np.float32]


def read_coverage(job: Job, headers: Headers, channel: str | None, key: str) -> tuple[F32, str]:
    """Coverage [H, W] as stored, and the names of its channels.

    Args:
        job: says which window of the picture is read.
        headers: of all parts of the file.
        channel: that the job names; None: the obvious one.
        key: of the job file, for messages.

    Raises:
        JobError: no channel is obvious.
    """
    channels = find_matte(headers, channel, key)
    plane, *others = read_placed(job, channels)
    if any(not np.array_equal(plane, other) for other in others):
        raise _unclear(f"The red, green and blue of the {_word(key)} differ", channels, key)
    if channel is None and channels[0].component.lower() in ALPHA and plane.min() >= 1:
        _refuse_empty_alpha(job, headers, channels, key)
    return plane, labels(channels)


def _refuse_empty_alpha(job: Job, headers: Headers, alpha: Sequence[Channel], key: str) -> None:
    """Refuses an alpha that covers everything beside colours that do not: the picture was painted in colour.

    Raises:
        JobError: as said.
    """
    groups = layer_groups(channels_of(headers, None, key), RED_GREEN_BLUE)
    colors = [group["R"] for group in groups if not group["R"].layer]
    if colors and np.ptp(read_placed(job, colors)[0]) > 0:
        raise _unclear(f"The alpha of the {_word(key)} is 1 everywhere, and its colour is not", [*alpha, *colors], key)


def _unclear(what: str, channels: Sequence[Channel], key: str) -> JobError:
    return JobError(
        what, f"{channels[0].header.path}, key {key}", f"one of {labels(channels)}", f"name it with `channel:` of {key}"
    )


def _word(key: str) -> str:
    return "matte" if key == "matte" else "mask"
