"""What all sections of the job file share."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Colorspace = Annotated[str, Field(min_length=1, max_length=200)]
"""A space of the OpenColorIO configuration by name or role; `lin_rec709`, `acescg` and `srgb` need none."""


class Part(BaseModel):
    """A frozen section of the job; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
