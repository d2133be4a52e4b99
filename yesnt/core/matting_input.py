"""Section of the job file about mattes that the run makes from the capture's pictures (docs/capture.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from yesnt.core.job_part import Part

FOLDER = "mattes"
"""Folder below a job's output that holds the mattes, in a folder for each camera."""

MADE = FOLDER + "/{camera}/matte.####.png"
"""Names of the mattes in the output folder."""

MEDIAN, NONE = "median", "none"
"""Words that `background` takes in place of a pattern."""


class Matting(Part):
    """How mattes are made from the pictures.

    `background` is what a camera at rest shows without the subject: `median` of its own pictures over time, a pattern
    of clean plates with `{camera}` (pictures or videos), or `none`. `person` finds persons by MediaPipe's models, whose
    folder `weights` names; absent: that of the installed package. `consistent` removes and fills what the hull of the
    other cameras contradicts.
    """

    background: Annotated[str, Field(min_length=1)] = MEDIAN
    person: bool = False
    consistent: bool = True
    weights: Annotated[str, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.background == NONE and not self.person:
            raise ValueError("with `background: none` and without `person: true` there is nothing to make mattes from")
        if self.weights is not None and not self.person:
            raise ValueError("`weights` are those of `person: true`")
        if self.clean_plates is not None and "{camera}" not in self.background:
            raise ValueError("`background` is `median`, `none`, or a pattern with {camera} of clean plates")
        return self

    @property
    def clean_plates(self) -> str | None:
        """Pattern of the clean plates; None where there are none."""
        return None if self.background in (MEDIAN, NONE) else self.background

    @property
    def has_background(self) -> bool:
        """Whether pictures are compared with a background."""
        return self.background != NONE


def fill_mattes(data: Any) -> Any:
    """A job's data with the pattern of the mattes that its run makes.

    Raises:
        ValueError: the job names mattes of its own too.
    """
    capture = data.get("capture") if isinstance(data, Mapping) else None
    if not isinstance(capture, Mapping) or capture.get("matting") is None:
        return data
    made = f"{data.get('output', 'out')}/{MADE}"
    if capture.get("mattes") not in (None, made):
        raise ValueError("capture has both `mattes` and `matting`, which makes them: leave one of them out")
    return {**data, "capture": {**capture, "mattes": made}}
