"""The section `set` of the job file: what the subject stands on (docs/set.md)."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from yesnt.core.job_part import Part
from yesnt.core.scene_input import scene_file

MIRROR = 0.05
"""Roughness below which a surface shows what it reflects point by point."""

_Share = Annotated[float, Field(ge=0, le=1)]


_OF_SURFACES = frozenset({"color", "roughness", "metallic", "radius"})
_OF_SCENES = frozenset({"at", "yaw"})


class SetInput(Part):
    """A ground plane or a mesh around the subject, with one material.

    `ground` is a height, world z in metres, or `auto`: fitted under the feet over the whole shot. `mesh` is a mesh file
    in world metres. `color` is the base colour, linear in the working space. `show` renders the set, and the light's
    map beyond it; `catch` leaves a background plate as it is, but for the subject's shadow and reflection. The ground
    ends softly: it fades from half of `radius`, metres, to all of it.

    `blend` is a scene of Blender (.blend, .gltf, .glb) instead: `at` is where the origin of the shot's world stands in
    it, in metres, `yaw` turns that world about the vertical, in degrees, counter-clockwise from above.
    """

    ground: Literal["auto"] | float | None = None
    mesh: str | None = None
    color: Annotated[tuple[_Share, _Share, _Share], Field(strict=False)] = (0.5, 0.5, 0.5)
    roughness: _Share = 0.8
    metallic: _Share = 0.0
    mode: Literal["show", "catch"] = "show"
    radius: Annotated[float, Field(ge=0.5, le=10000)] = 10.0
    blend: Annotated[str, AfterValidator(scene_file)] | None = None
    at: Annotated[tuple[float, float, float], Field(strict=False)] = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    @model_validator(mode="after")
    def _one_surface(self) -> Self:
        if sum(one is not None for one in (self.ground, self.mesh, self.blend)) != 1:
            raise ValueError("it needs one of `ground`, `mesh` and `blend`")
        of_others = _OF_SURFACES if self.blend is not None else _OF_SCENES
        if odd := sorted(of_others & self.model_fields_set):
            raise ValueError(f"`{odd[0]}` is of {'a ground or a mesh' if self.blend is not None else '`blend`'}")
        if self.mesh is not None and "radius" in self.model_fields_set:
            raise ValueError("`radius` is of a ground, a mesh has its own size")
        return self

    @property
    def shows_sides(self) -> bool:
        """Whether it shows sides of the subject in detail that the delivered view does not: a mirror, or a scene."""
        return self.blend is not None or self.roughness < MIRROR


def refuse_unusable_set(given: SetInput | None, has_proxy: bool, has_background: bool, shadows: object) -> None:
    """Refuses sections that do not go together.

    Args:
        given: the section.
        has_proxy: whether the job has a proxy.
        has_background: whether it has a background plate.
        shadows: the knob of relighting.

    Raises:
        ValueError: `set` without a proxy, `mode: catch` without a background, or `mode: show` with one; `set` without
            a visibility per light cluster.
    """
    if given is None:
        return
    if not has_proxy:
        raise ValueError("`set` needs `proxy`, which casts the shadow")
    if shadows is not True:
        raise ValueError("`set` needs `relight.shadows: true`: the subject and its set are in each other's light")
    if given.mode == "catch" and not has_background:
        raise ValueError("`set.mode: catch` needs `background`, which receives the shadow; or set mode: show")
    if given.mode == "show" and has_background:
        raise ValueError("`set.mode: show` renders what is behind the subject; remove `background`, or set mode: catch")
