"""What all sections of the job file share."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Colorspace = Annotated[str, Field(min_length=1, max_length=200)]
"""A space of the OpenColorIO configuration by name or role; `lin_rec709`, `acescg` and `srgb` need none."""


Knob = bool | int | float | str
"""A value of a setting that is passed on by name."""

FIXED = "(fixed)"
"""Tag of a value given as such, where there are other ways; error messages leave tags, which stand in brackets, out of
the key's name."""


class Part(BaseModel):
    """A frozen section of the job; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
