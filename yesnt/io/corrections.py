"""Reads what a job corrects in a frame's materials: passes of one quantity, masks and Cryptomattes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.material_input import MATERIAL, MaterialInput
from yesnt.core.shot import Job
from yesnt.decompose.corrections import Override, share_of_subject
from yesnt.io.jobfile import frame_path
from yesnt.io.pictures.coverage import read_coverage
from yesnt.io.pictures.cryptomattes import read_named
from yesnt.io.pictures.image import read_headers
from yesnt.io.pictures.material_pass import read_quantity, refuse_not_finite

F32 = NDArray[np.float32]

LARGEST_SHARE = 2.0
"""A mask above this is not coverage with a filter's overshoot: it is in other units, such as 0 to 255."""


@dataclass
class CorrectionFacts:
    """What the corrections of one frame meet, for the checks before a run.

    Attributes:
        touched: per entry of `materials:` how many pixels of the matte it changes.
        absent: per entry the names that the frame does not know.
        known: per entry the names of the frame's manifest.
        clamped: values of masks and passes outside [0, 1], set to its ends.
    """

    touched: list[int] = field(default_factory=list)
    absent: list[tuple[str, ...]] = field(default_factory=list)
    known: list[tuple[str, ...]] = field(default_factory=list)
    clamped: int = 0


def read_overrides(job: Job, frame: int, matte: F32) -> tuple[list[Override], CorrectionFacts]:
    """All corrections of a frame in their order: passes of one quantity, then `materials:`.

    Args:
        job: the job.
        frame: frame number.
        matte: [H, W] coverage of the subject.

    Raises:
        JobError: a file cannot be used.
    """
    facts, overrides = CorrectionFacts(), list[Override]()
    if job.shot.decompose.samples_backend:
        for name, spec in job.shot.decompose.quantities.items():
            plane, clamped = read_quantity(job, name, spec, frame, matte)
            facts.clamped += clamped
            overrides.append(Override(MATERIAL.index(name), plane, np.ones_like(matte)))
    for number, one in enumerate(job.shot.materials):
        share = share_of_subject(_coverage(job, one, f"materials.{number}", frame, matte, facts), matte)
        facts.touched.append(int((share[matte > 0] > 0).sum()))
        overrides += _overrides(one, share)
    return overrides, facts


def _coverage(job: Job, spec: MaterialInput, key: str, frame: int, matte: F32, facts: CorrectionFacts) -> F32:
    """Coverage [H, W] in [0, 1] of an override's mask or names."""
    headers = read_headers(frame_path(job.root, spec.path, frame))
    if spec.cryptomatte is not None:
        found = read_named(job, spec, headers, key)
        facts.absent.append(found.absent)
        facts.known.append(found.known)
        return found.coverage
    facts.absent.append(())
    facts.known.append(())
    plane, channels = read_coverage(job, headers, spec.channel, key)
    path, inside = headers[0].path, matte > 0
    refuse_not_finite(plane, inside, path, channels)
    plane = np.where(inside, plane, 0)
    if plane.max(initial=0) > LARGEST_SHARE:
        raise JobError(
            f"The mask goes up to {plane.max():g}", f"{path}, key {key}, channel {channels}",
            "coverage from 0 to 1", "divide it by its largest value, or name the right channel with `channel:`",
        )  # fmt: skip
    facts.clamped += int(((plane < 0) | (plane > 1)).sum())
    return np.clip(plane, 0, 1).astype(np.float32)


def _overrides(spec: MaterialInput, share: F32) -> Iterator[Override]:
    for quantity, change in enumerate(spec.overrides):
        if change is not None:
            yield Override(quantity, change, share)
