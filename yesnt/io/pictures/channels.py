"""Finds the channels of a picture that the job means, under the names that programs of the field give them.

A channel is called `layer.component`; in a file of several parts also `part.layer.component` (Blender 5 writes a part
for each pass). Stereo files name a view of each channel (openexr.com, "Storing Multi-View Images").
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from yesnt.core.errors import JobError
from yesnt.io.pictures.image import ImageHeader

SHOWN = 12
"""Names that a message lists, at most."""

RED_GREEN_BLUE = {"R": ("r", "red"), "G": ("g", "green"), "B": ("b", "blue")}
X_Y_Z = {"X": ("x", "r", "red"), "Y": ("y", "g", "green"), "Z": ("z", "b", "blue")}
ALPHA = ("a", "alpha")
"""Spellings of components, in lower case."""

WITH_VIEW = ("plate", "background", "gbuffer")
"""Sections of the job file that may name a view."""


@dataclass(frozen=True)
class Channel:
    """A stored channel.

    Attributes:
        header: of its part.
        name: as stored.
        view: eye of a stereo file; "": none.
        part_layer: its layer, with the part's name before it in a file of several parts.
        layer: its layer as stored.
        component: what follows the last dot.
    """

    header: ImageHeader
    name: str
    view: str
    part_layer: str
    layer: str
    component: str

    @property
    def full_names(self) -> frozenset[str]:
        """What a job may call it."""
        return frozenset({self.name, _joined(self.layer, self.component), _joined(self.part_layer, self.component)})

    @property
    def label(self) -> str:
        """How messages call it: with its part."""
        return _joined(self.part_layer, self.component)

    @property
    def layers(self) -> frozenset[str]:
        """What a job may call its layer: with the part's name, without it, or the part alone."""
        return frozenset({self.layer, self.part_layer} | ({self.header.name} if not self.layer else set()))


def all_channels(headers: Sequence[ImageHeader]) -> list[Channel]:
    """The channels of all parts and views."""
    return [channel for header in headers for channel in _of_part(header)]


def channels_of(headers: Sequence[ImageHeader], view: str | None, key: str) -> list[Channel]:
    """The channels of all parts; of one view where the file has several.

    Args:
        headers: of all parts.
        view: the view that the job names.
        key: of the job file, for messages.

    Raises:
        JobError: the file has several views and the job names none, or one that is absent.
    """
    found = all_channels(headers)
    views = sorted({channel.view for channel in found if channel.view})
    if view is not None and view not in views:
        raise JobError(
            f"The picture has no view {view!r}", headers[0].path, f"one of {', '.join(views) or 'no views at all'}",
            f"correct `view:` of key {key}",
        )  # fmt: skip
    if view is None and len(views) > 1:
        raise JobError(
            f"The picture has the views {', '.join(views)}", headers[0].path, "one view",
            f"name it with `view:` under key {key}" if key in WITH_VIEW else "export one view alone",
        )  # fmt: skip
    return [channel for channel in found if view is None or channel.view in ("", view)]


def named(channels: Sequence[Channel], name: str, key: str) -> Channel:
    """The channel of a full name.

    Raises:
        JobError: none, or several of different parts.
    """
    found = [channel for channel in channels if channel.name == name] or [
        channel for channel in channels if name in channel.full_names
    ]
    if not found:
        raise _absent(f"channel {name}", [c.label for c in channels], name, _path(channels), key)
    return _only(found, f"channel {name}", key)


def layer_groups(channels: Iterable[Channel], components: Mapping[str, Sequence[str]]) -> list[dict[str, Channel]]:
    """Layers, each within one part, that have all the components (role -> spellings), as channel by role."""
    roles = {spelling: role for role, spellings in components.items() for spelling in spellings}
    layers: dict[tuple[int, str], dict[str, Channel]] = {}
    for channel in channels:
        role = roles.get(channel.component.lower())
        if role is not None:
            layers.setdefault((channel.header.part, channel.layer), {}).setdefault(role, channel)
    return [group for group in layers.values() if len(group) == len(components)]


def last_word(layer: str) -> str:
    """The last element of a nested layer's name, in lower case."""
    return layer.rpartition(".")[2].lower()


def only_group(groups: Sequence[dict[str, Channel]], what: str, key: str, how: str) -> dict[str, Channel]:
    """The only group.

    Raises:
        JobError: several; `how` says which key of the job file chooses one.
    """
    if len(groups) > 1:
        names = sorted({next(iter(group.values())).part_layer or "(unnamed)" for group in groups})
        path = next(iter(groups[0].values())).header.path
        raise JobError(
            f"Several layers may be {what}: {_listed(names)}", path, "one that is meant", f"name it with {how} of {key}"
        )
    return groups[0]


def absent_layer(channels: Sequence[Channel], what: str, layer: str, key: str) -> JobError:
    """The error of a layer that no part has."""
    names = sorted({channel.part_layer for channel in channels if channel.part_layer})
    return _absent(f"{what} {layer}", names or [c.label for c in channels], layer, _path(channels), key)


def _absent(what: str, there: Sequence[str], wanted: str, path: str, key: str) -> JobError:
    near = difflib.get_close_matches(wanted, there, 3, 0.6)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    return JobError(
        f"The picture has no {what}", path, f"{wanted}; it has {_listed(there)}",
        f"{hint}name the right one under key {key}, or export it with this one",
    )  # fmt: skip


def _only(found: Sequence[Channel], what: str, key: str) -> Channel:
    if len(found) > 1:
        names = ", ".join(sorted(f"{c.label} of part {c.header.name or c.header.part + 1}" for c in found))
        raise JobError(
            f"Several channels are called so: {what} is {names}", found[0].header.path, "one that is meant",
            f"write the part's name before it under key {key}",
        )  # fmt: skip
    return found[0]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _path(channels: Sequence[Channel]) -> str:
    return channels[0].header.path if channels else ""


def _joined(layer: str, component: str) -> str:
    return f"{layer}.{component}" if layer else component


def _of_part(header: ImageHeader) -> Iterable[Channel]:
    views = tuple(header.attributes.get("multiView", ()))
    part_view = str(header.attributes.get("view", ""))
    part_name = _without(header.name, part_view)
    for name in header.channels:
        view, plain = (part_view, _without(name, part_view)) if part_view else _split_view(name, views)
        layer, _, component = plain.rpartition(".")
        inside = not part_name or layer == part_name or layer.startswith(f"{part_name}.")
        yield Channel(header, name, view, layer if inside else _joined(part_name, layer).rstrip("."), layer, component)


def _split_view(name: str, views: Sequence[str]) -> tuple[str, str]:
    """View and the rest of a channel's name: `left.R`, `diffuse.left.R`; a name without layer is of the first view."""
    words = name.split(".")
    if len(words) > 1 and words[-2] in views:
        return words[-2], ".".join((*words[:-2], words[-1]))
    return (views[0] if views and len(words) == 1 else ""), name


def _without(name: str, view: str) -> str:
    """A layer's or channel's name without the word of its view."""
    return ".".join(word for word in name.split(".") if word != view) if view else name
