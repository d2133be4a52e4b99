"""Finds the Cryptomattes of a picture and the coverage of named things in one of them.

Metadata and channel names follow the Cryptomatte specification 1.2.0: `cryptomatte/KEY/name`, `/hash`, `/conversion`,
`/manifest` or `/manif_file`; layers NAME00, NAME01, ... with two ranks each. Blender writes the metadata into the first
part and every layer as a part of its own.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.material_input import MaterialInput
from yesnt.core.shot import Job
from yesnt.decompose.cryptomatte import coverage, identifier
from yesnt.io.pictures.channels import ALPHA, RED_GREEN_BLUE, Channel, channels_of, layer_groups
from yesnt.io.pictures.image import ImageHeader
from yesnt.io.pictures.placed import read_placed

F32 = NDArray[np.float32]

HASH, CONVERSION = "MurmurHash3_32", "uint32_to_float32"
"""The hash and the conversion that the specification knows."""

_METADATA = re.compile(r"(^|/)cryptomatte/(?P<key>[^/]+)/(?P<field>[^/]+)$")
"""Name of a metadata attribute; Nuke writes `nuke/exr/` before it."""

_LAYER = re.compile(r"(?P<name>.+?)(?P<rank>\d\d)$")
_RANKS = {**RED_GREEN_BLUE, "A": ALPHA}
_MOSTLY, _FOREIGN = 0.5, 0.5
"""Coverage of a pixel that is looked at, and share of such pixels with unknown identifiers, for `_refuse_damaged`."""

_PIXELS_NAMED = 1e-3
"""Coverage below this is no sign that a thing is in the picture."""


@dataclass(frozen=True)
class Cryptomatte:
    """One Cryptomatte of a picture.

    Attributes:
        name: of its layers, without their number.
        layers: red, green, blue and alpha channel of each layer, in order of rank.
        manifest: bits of the identifier by name; None if the file brings none.
    """

    name: str
    layers: tuple[Mapping[str, Channel], ...]
    manifest: Mapping[str, int] | None


@dataclass(frozen=True)
class NamedCoverage:
    """What a Cryptomatte says of some names in one frame.

    Attributes:
        coverage: [H, W] in [0, 1].
        absent: names that the frame's manifest does not hold; without a manifest, that no pixel holds.
        known: all names of the manifest.
    """

    coverage: F32
    absent: tuple[str, ...]
    known: tuple[str, ...]


def read_named(job: Job, spec: MaterialInput, headers: Sequence[ImageHeader], key: str) -> NamedCoverage:
    """Coverage of the names of an override in one frame.

    Args:
        job: says which window of the picture is read.
        spec: the override: names, and the Cryptomatte that names them.
        headers: of all parts of the file.
        key: of the job file, for messages.

    Raises:
        JobError: the file has no Cryptomatte, or none or several that are meant, or its identifiers are damaged.
    """
    chosen = _choose(_cryptomattes(headers, key), spec, headers[0].path, key)
    channels = [layer[role] for layer in chosen.layers for role in "RGBA"]
    _refuse_rounded(channels)
    planes = read_placed(job, channels)
    ranks = list(zip(planes[0::2], planes[1::2], strict=True))
    known = chosen.manifest if chosen.manifest is not None else {}
    _refuse_damaged(ranks[0], known, headers[0].path, chosen.name)
    numbers = {name: known.get(name, identifier(name)) for name in spec.names}
    if chosen.manifest is not None:
        absent = tuple(name for name in spec.names if name not in known)
    else:
        absent = tuple(name for name, one in numbers.items() if coverage(ranks, {one}).max() < _PIXELS_NAMED)
    return NamedCoverage(coverage(ranks, set(numbers.values())), absent, tuple(known))


def chosen_name(spec: MaterialInput, headers: Sequence[ImageHeader], key: str) -> str:
    """The name of the Cryptomatte that an override means.

    Raises:
        JobError: as `read_named`.
    """
    return _choose(_cryptomattes(headers, key), spec, headers[0].path, key).name


def unknown_name(name: str, known: Iterable[str], path: str, key: str) -> JobError:
    """The error of a name that no frame of the shot holds."""
    known = sorted(set(known))
    near = difflib.get_close_matches(name, known, 3, 0.5)
    shown = near or known[:12]
    expected = f"a name of its manifest, such as {', '.join(shown)}" if shown else "a name whose pixels are in the file"
    return JobError(
        f"The Cryptomatte has no {name!r} in any frame", f"{path}, key {key}", expected,
        f"did you mean {' or '.join(near)}? correct `names`" if near else "correct `names`, or name another `layer`",
    )  # fmt: skip


def _cryptomattes(headers: Sequence[ImageHeader], key: str) -> list[Cryptomatte]:
    """All Cryptomattes of a file, by its metadata; without any, by the names of its layers."""
    channels = channels_of(headers, None, key)
    groups = layer_groups(channels, _RANKS)
    stated = {str(fields["name"]): fields for fields in _metadata(headers) if "name" in fields}
    found = []
    for name in stated or _named_like_cryptomattes(groups):
        fields = stated.get(name, {})
        _refuse_other_hash(fields, headers[0].path)
        layers = _layers(groups, name)
        if layers:
            found.append(Cryptomatte(name, layers, _manifest(fields, Path(headers[0].path).parent)))
    return found


def _metadata(headers: Sequence[ImageHeader]) -> Iterable[dict[str, Any]]:
    """The metadata of each Cryptomatte: field -> value."""
    by_key: dict[str, dict[str, Any]] = {}
    for header in headers:
        for attribute, value in header.attributes.items():
            found = _METADATA.search(attribute)
            if found:
                by_key.setdefault(found["key"], {}).setdefault(found["field"], value)
    return by_key.values()


def _named_like_cryptomattes(groups: Sequence[Mapping[str, Channel]]) -> list[str]:
    found = (_LAYER.match(group["R"].part_layer) for group in groups)
    return list(dict.fromkeys(one["name"] for one in found if one and "crypto" in one["name"].lower()))


def _layers(groups: Sequence[Mapping[str, Channel]], name: str) -> tuple[Mapping[str, Channel], ...]:
    """Layers NAME00, NAME01, ... in order, with or without the name of their part."""
    ranked = {}
    for group in groups:
        for layer in group["R"].layers:
            found = _LAYER.match(layer)
            if found and found["name"] == name:
                ranked[int(found["rank"])] = group
    return tuple(ranked[rank] for rank in sorted(ranked))


def _manifest(fields: Mapping[str, Any], folder: Path) -> dict[str, int] | None:
    """Name -> bits of the identifier; None where there is no manifest that can be read: names are then hashed."""
    text = fields.get("manifest")
    if text is None and "manif_file" in fields:
        beside = folder / str(fields["manif_file"])
        text = beside.read_text(encoding="utf-8") if beside.is_file() else None
    try:
        found = json.loads(str(text)) if text is not None else None
        return {str(name): int(bits, 16) for name, bits in found.items()} if found else None
    except (ValueError, AttributeError, TypeError):
        return None


def _choose(found: Sequence[Cryptomatte], spec: MaterialInput, path: str, key: str) -> Cryptomatte:
    if not found:
        raise JobError(
            "The picture has no Cryptomatte", f"{path}, key {key}", "layers such as CryptoObject00, with metadata",
            "switch the Cryptomatte pass on and render again, or give a `mask`",
        )  # fmt: skip
    names = ", ".join(one.name for one in found)
    if spec.layer is not None:
        meant = [one for one in found if spec.layer == one.name or one.name.endswith(f".{spec.layer}")]
        if len(meant) != 1:
            raise JobError(f"No Cryptomatte is called {spec.layer!r}", f"{path}, key {key}.layer", names, "correct it")
        return meant[0]
    holding = [one for one in found if one.manifest is None or not set(spec.names).isdisjoint(one.manifest)]
    if len(holding) > 1:
        raise JobError(
            f"Several Cryptomattes may be meant: {', '.join(one.name for one in holding)}", f"{path}, key {key}",
            "one of them", "name it with `layer:`",
        )  # fmt: skip
    return holding[0] if holding else _merged(found)


def _merged(found: Sequence[Cryptomatte]) -> Cryptomatte:
    """The first Cryptomatte with the names of all, for messages: none of them holds what is asked for."""
    every = {name: bits for one in found for name, bits in (one.manifest or {}).items()}
    return Cryptomatte(found[0].name, found[0].layers, every)


def _refuse_rounded(channels: Sequence[Channel]) -> None:
    """Refuses identifiers that were stored as half: they are no longer those of any name.

    Raises:
        JobError: as said.
    """
    for channel in channels:
        kind = channel.header.kinds[channel.header.channels.index(channel.name)]
        if kind != "float":
            raise JobError(
                f"The Cryptomatte's channel {channel.label} is {kind}: its identifiers are rounded",
                channel.header.path, "32-bit float", "write the Cryptomatte as 32-bit float, without lossy compression",
            )  # fmt: skip


def _refuse_damaged(first: tuple[F32, F32], known: Mapping[str, int], path: str, name: str) -> None:
    """Refuses identifiers of which most are in no manifest: they were resized, filtered or compressed with loss.

    Raises:
        JobError: as said.
    """
    covered = first[1] > _MOSTLY
    if not known or not covered.any():
        return
    numbers = np.array([0, *known.values()], np.uint32)  # 0 is the background
    foreign = float((~np.isin(first[0].view(np.uint32)[covered], numbers)).mean())
    if foreign > _FOREIGN:
        raise JobError(
            f"{foreign:.0%} of the identifiers of the Cryptomatte {name} are not in its manifest", path,
            "identifiers as they were rendered",
            "render it again, or copy it without resizing, filtering or lossy compression (DWA, PXR24)",
        )  # fmt: skip


def _refuse_other_hash(fields: Mapping[str, Any], path: str) -> None:
    for field, expected in (("hash", HASH), ("conversion", CONVERSION)):
        if fields.get(field, expected) != expected:
            raise JobError(
                f"The Cryptomatte's {field} is {fields[field]!r}", path, expected, "render it with a current plug-in"
            )
