"""Section of the job file about Gaussian opacity fields (docs/gaussians.md), and what a job takes from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field, model_validator

from yesnt.core.job_part import Knob, Part

FOLDER = "gaussians"
"""Folder below a job's output that holds what is made from the fields."""

FIELD, VIEW, PROXY = f"{FOLDER}/field.####.ply", f"{FOLDER}/view.####.exr", f"{FOLDER}/proxy.####.ply"
"""Names of the fitted fields, the rendered pictures and the meshes in the output folder."""

_MADE = {"plate": VIEW, "gbuffer": VIEW, "proxy": PROXY}


class GaussianInput(Part):
    """A field a frame: 3DGS PLY files that were fitted elsewhere (`path`), or fitted here to the pictures of `capture`.

    Plate, G-buffer and proxy that the job does not name are rendered and extracted from the fields. Every `every`-th
    frame is a keyframe, which is fitted from the visual hull; the others start from the nearest keyframe's field.
    `held_out` cameras only measure the fit; absent: one in twelve. `knobs` are fields of `FitSettings`, `LossWeights`
    and `MeshSettings`.
    """

    path: Annotated[str, Field(min_length=1)] | None = None
    every: Annotated[int, Field(ge=1, le=4096)] = 8
    held_out: Annotated[int, Field(ge=0, le=64)] | None = None
    knobs: dict[str, Knob] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _without_device(cls, data: Any) -> Any:
        """Refuses a device by name: users of other programs choose a GPU so."""
        given = data if isinstance(data, Mapping) else {}
        knobs = given.get("knobs")
        if "device" in given or (isinstance(knobs, Mapping) and "device" in knobs):
            raise ValueError(
                "`device` is not known: fields are fitted, rendered and meshed on the CPU. Leave it out; fields that "
                "were fitted on a GPU (gsplat, nerfstudio, Inria's program) are read by `path: field.####.ply`"
            )
        return data


def held_out_of(names: Sequence[str], count: int | None) -> tuple[str, ...]:
    """Cameras that only measure a fit, spread evenly over those of a capture; None: one in twelve."""
    count = len(names) // 12 if count is None else count
    return tuple(names[int((i + 0.5) * len(names) / count)] for i in range(count))


def fill_from_field(data: Any) -> Any:
    """A job's data with the paths of what is made from its fields, where the job names no files of its own.

    Raises:
        ValueError: the job names all of them, so that its fields would serve nothing; or it has neither fields nor a
            capture to fit them to.
    """
    if not isinstance(data, Mapping) or data.get("gaussians") is None:
        return data
    given = data["gaussians"]
    if isinstance(given, Mapping) and given.get("path") is None and data.get("capture") is None:
        raise ValueError("`gaussians` needs `path`, or `capture` with the pictures that the fields are fitted to")
    output = data.get("output", "out")
    made = {key: {"path": f"{output}/{name}"} for key, name in _MADE.items() if data.get(key) is None}
    if not made:
        raise ValueError("`gaussians` is not used: `plate`, `gbuffer` and `proxy` are all given; leave one of them out")
    return {**data, **made}


def is_made(path: str, output: str) -> bool:
    """Whether a pattern is that of something made from the fields."""
    return path in {f"{output}/{name}" for name in _MADE.values()}
