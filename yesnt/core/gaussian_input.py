"""Section of the job file about Gaussian opacity fields (docs/gaussians.md), and what a job takes from them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from yesnt.core.job_part import Knob, Part

FOLDER = "gaussians"
"""Folder below a job's output that holds what is made from the fields."""

VIEW, PROXY = f"{FOLDER}/view.####.exr", f"{FOLDER}/proxy.####.ply"
"""Names of the rendered pictures and the meshes in the output folder."""

_MADE = {"plate": VIEW, "gbuffer": VIEW, "proxy": PROXY}


class GaussianInput(Part):
    """A field a frame, as 3DGS PLY files; `knobs` are fields of `MeshSettings`.

    Plate, G-buffer and proxy that the job does not name are rendered and extracted from the fields.
    """

    path: Annotated[str, Field(min_length=1)]
    knobs: dict[str, Knob] = Field(default_factory=dict)


def fill_from_field(data: Any) -> Any:
    """A job's data with the paths of what is made from its fields, where the job names no files of its own.

    Raises:
        ValueError: the job names all of them, so that its fields would serve nothing.
    """
    if not isinstance(data, Mapping) or data.get("gaussians") is None:
        return data
    output = data.get("output", "out")
    made = {key: {"path": f"{output}/{name}"} for key, name in _MADE.items() if data.get(key) is None}
    if not made:
        raise ValueError("`gaussians` is not used: `plate`, `gbuffer` and `proxy` are all given; leave one of them out")
    return {**data, **made}


def is_made(path: str, output: str) -> bool:
    """Whether a pattern is that of something made from the fields."""
    return path in {f"{output}/{name}" for name in _MADE.values()}
