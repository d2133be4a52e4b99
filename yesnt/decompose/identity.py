"""Identity of a decomposition backend: what its results depend on besides the settings of the ensemble. No torch."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yesnt.core.errors import JobError
from yesnt.decompose.backend import Footprint
from yesnt.decompose.checkpoint import Published, fingerprint
from yesnt.decompose.registry import ENTRIES, check_licence, find_weights, footprint


@dataclass(frozen=True)
class BackendIdentity:
    """What the key of a frame's record holds of the backend.

    Attributes:
        name: name in the job file.
        version: version of our code for the backend.
        knobs: settings that the job gives, sorted by name.
        weights: hexadecimal digest of the weights.
        footprint: size and cost of one call.
    """

    name: str
    version: int
    knobs: tuple[tuple[str, Any], ...]
    weights: str
    footprint: Footprint


def identify_backend(
    name: str, weights: Path | None, accepted_licences: Collection[str], knobs: Mapping[str, Any] | None = None
) -> BackendIdentity:
    """Returns the identity of a backend after all checks of its files, before anything runs.

    Args:
        name: key of `yesnt.decompose.registry.ENTRIES`.
        weights: local file or folder; None: the file in the package.
        accepted_licences: names of non-commercial licences that the user has accepted.
        knobs: settings that the job gives for this backend.

    Raises:
        JobError: the backend is unknown, its licence was not accepted, a knob is not accepted, or weights are missing.
    """
    check_licence(name, accepted_licences)
    knobs = dict(knobs or {})
    path = find_weights(name, weights)
    if not path.exists():
        raise JobError(
            f"The weights of {name} are missing",
            str(path),
            "a local file of safetensors",
            "reinstall the package, or set decompose.weights",
        )
    digest = Published(name, "", ()).digest(path) if path.is_dir() else fingerprint(path).hex()
    size = footprint(name, path, knobs)
    return BackendIdentity(name, ENTRIES[name].version, tuple(sorted(knobs.items())), digest, size)
