"""Which channels of a file are the colour, the matte, z, the normals or a material, by the job or by well-known names.

Sources of the names: Blender (`ViewLayer.Combined`, `.Depth`, `.Normal`), Nuke (`rgba.red`, `depth.Z`), Arnold and
RenderMan (`Z`, `N.X`), Houdini (one part for each pass), V-Ray and Redshift (`beauty`, `Depth`, `normals`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from yesnt.core.errors import JobError
from yesnt.core.shot import GBufferInput, PlateInput
from yesnt.io.pictures.channels import (
    ALPHA,
    RED_GREEN_BLUE,
    X_Y_Z,
    Channel,
    absent_layer,
    all_channels,
    channels_of,
    last_word,
    layer_groups,
    named,
    only_group,
)
from yesnt.io.pictures.image import ImageHeader

BEAUTY = frozenset({"rgba", "rgb", "beauty", "combined", "main", "color", "colour"})
"""Last words of layers that hold the whole picture."""

NORMALS = frozenset({"n", "normal", "normals"})
DEPTHS = frozenset({"depth", "z"})
DEPTH_COMPONENTS = frozenset({"z", "v", "y", "r", "red", "depth"})
NO_COLOR = NORMALS | DEPTHS | {"p", "position", "uv", "st", "vector", "motion", "velocity", "forward", "backward"}
"""Last words of layers whose three components are not a colour."""

SCALARS = ("y", "v", "r", "red", "x")
"""Components of a layer that holds one number, the likeliest first."""

Headers = Sequence[ImageHeader]


@dataclass(frozen=True)
class ColorChannels:
    """Where a picture's colour is: red, green, blue, and coverage if the file has it."""

    color: tuple[Channel, Channel, Channel]
    alpha: Channel | None

    @property
    def label(self) -> str:
        """How `plan` prints it."""
        return labels((*self.color, *((self.alpha,) if self.alpha else ())))


def labels(channels: Sequence[Channel]) -> str:
    """Names of channels, as `plan` prints them."""
    return ", ".join(dict.fromkeys(channel.label for channel in channels))


def find_color(headers: Headers, spec: PlateInput, key: str) -> ColorChannels:
    """The channels of a colour picture.

    Raises:
        JobError: absent, or several layers may be it and the job does not say which.
    """
    channels = channels_of(headers, spec.view, key)
    if spec.channels:
        chosen = {role: named(channels, name, f"{key}.channels") for role, name in spec.channels.items()}
        return ColorChannels((chosen["R"], chosen["G"], chosen["B"]), chosen.get("A"))
    groups = layer_groups(channels, RED_GREEN_BLUE)
    if spec.layer is not None:
        meant = [group for group in groups if spec.layer in group["R"].layers]
        if not meant:
            raise absent_layer([c for group in groups for c in group.values()] or channels, "layer", spec.layer, key)
        group = only_group([g for g in meant if g["R"].part_layer == spec.layer] or meant, f"{key}'s colour", key, _HOW)
    elif groups:
        group = only_group(_likeliest(groups), f"{key}'s colour", key, _HOW)
    else:
        group = _grey(channels, key)
    return ColorChannels((group["R"], group["G"], group["B"]), _alpha_beside(channels, group["R"]))


_HOW = "`layer:` or `channels:`"


def _likeliest(groups: list[dict[str, Channel]]) -> list[dict[str, Channel]]:
    """The groups among which the colour is: unnamed ones, then well-known ones, then any that may be a colour."""
    single = groups[0]["R"].header.parts == 1
    bare = [group for group in groups if not group["R"].layer]
    known = [group for group in groups if last_word(group["R"].part_layer) in BEAUTY]
    may_be = [group for group in groups if not _is_data(group["R"].part_layer)]
    return (bare if single else []) or known or [g for g in bare if g in may_be] or may_be or groups


def _is_data(layer: str) -> bool:
    word = last_word(layer)
    return word in NO_COLOR or word.startswith("crypto")


def _grey(channels: Sequence[Channel], key: str) -> dict[str, Channel]:
    """A picture of luminance alone serves as all three colours."""
    grey = [channel for channel in channels if channel.component.lower() == "y" and not channel.layer]
    if len(grey) != 1:
        names = labels(channels)
        where = channels[0].header.path if channels else ""
        raise JobError(
            f"No channels of the picture are the {key}'s red, green and blue", where, f"R, G, B; it has {names}",
            f"name them under `channels:` of key {key}, or export them",
        )  # fmt: skip
    return dict.fromkeys(("R", "G", "B"), grey[0])


def _alpha_beside(channels: Sequence[Channel], red: Channel) -> Channel | None:
    """The coverage in a colour's own layer and part."""
    layer = (red.header.part, red.layer)
    beside = [c for c in channels if (c.header.part, c.layer) == layer and c.component.lower() in ALPHA]
    return beside[0] if beside else None


def find_matte(headers: Headers, channel: str | None, key: str = "matte") -> tuple[Channel, ...]:
    """The channel of a matte's own file; three where it is a grey picture stored as colour, which must be equal.

    Raises:
        JobError: absent, or not obvious.
    """
    if channel is not None:
        return (named(all_channels(headers), channel, key),)
    channels = channels_of(headers, None, key)
    alphas = [c for c in channels if c.component.lower() in ALPHA and not c.layer]
    if len(channels) == 1 or len(alphas) == 1:
        return ((alphas or channels)[0],)
    groups = layer_groups(channels, RED_GREEN_BLUE)
    if len(groups) == 1 and len(channels) == len(RED_GREEN_BLUE):
        return tuple(groups[0].values())
    raise JobError(
        "The matte's file has several channels", headers[0].path, f"one of {labels(channels)}",
        f"name it with `channel:` of key {key}",
    )  # fmt: skip


def find_z(headers: Headers, spec: GBufferInput) -> Channel:
    """The channel of z.

    Raises:
        JobError: absent or ambiguous.
    """
    channels = channels_of(headers, spec.view, "gbuffer")
    default = GBufferInput.model_fields["z"].default
    known = [c for c in channels if spec.z == c.name] or [c for c in channels if spec.z in c.full_names]
    if not known and spec.z == default:
        known = [c for c in channels if _is_depth(c)]
    if len(known) == 1:
        return known[0]
    if not known:
        return named(channels, spec.z, "gbuffer.z")
    raise JobError(
        f"Several channels may be the depth: {labels(known)}", known[0].header.path, "one that is meant",
        "name it with `z:` of key gbuffer",
    )  # fmt: skip


def _is_depth(channel: Channel) -> bool:
    component = channel.component.lower()
    if last_word(channel.part_layer) in DEPTHS:
        return component in DEPTH_COMPONENTS
    return not channel.layer and component in DEPTHS


def find_normals(headers: Headers, spec: GBufferInput) -> tuple[Channel, Channel, Channel]:
    """The channels of the normals' x, y and z.

    Raises:
        JobError: absent or ambiguous.
    """
    channels = channels_of(headers, spec.view, "gbuffer")
    groups = layer_groups(channels, X_Y_Z)
    known = [g for g in groups if spec.normal in g["X"].layers]
    known = [g for g in known if g["X"].part_layer == spec.normal] or known or _joined_names(channels, {spec.normal})
    if not known and spec.normal == GBufferInput.model_fields["normal"].default:
        known = [g for g in groups if last_word(g["X"].part_layer) in NORMALS] or _joined_names(channels, NORMALS)
    if not known:
        raise absent_layer(channels, "normals", spec.normal, "gbuffer.normal")
    group = only_group(known, "the normals", "gbuffer", "`normal:`")
    return group["X"], group["Y"], group["Z"]


def _joined_names(channels: Sequence[Channel], names: frozenset[str] | set[str]) -> list[dict[str, Channel]]:
    """Normals whose axis is joined to their name without a dot: `nx`, `NormalX`."""
    found = []
    for name in sorted({name.lower() for name in names}):
        found += layer_groups(channels, {axis: (f"{name}{axis.lower()}",) for axis in "XYZ"})
    return found


def find_scalar(headers: Headers, name: str, key: str) -> Channel:
    """The channel of one number a pixel, such as roughness: `roughness.Y`, `roughness`, `ViewLayer.Roughness.X`.

    Raises:
        JobError: absent or ambiguous.
    """
    channels = channels_of(headers, None, key)
    exact = [c for c in channels if {f"{name}.Y", name} & c.full_names]
    found = exact or [c for c in channels if last_word(c.part_layer) == name and c.component.lower() in SCALARS]
    found = found or [c for c in channels if not c.layer and c.component.lower() == name]
    if not found:
        return named(channels, f"{name}.Y", key)
    if len({(c.header.part, c.layer) for c in found}) > 1:
        raise JobError(
            f"Several channels may be the {name}: {labels(found)}", found[0].header.path, "one", "export one alone"
        )
    return min(found, key=lambda c: (c.component.lower() not in SCALARS, _place(c.component.lower())))


def _place(component: str) -> int:
    return SCALARS.index(component) if component in SCALARS else len(SCALARS)
