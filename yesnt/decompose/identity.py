"""What a decomposition's result depends on beside its ensemble's settings, told without importing torch."""

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
    """Name of a backend in the job file, version of our code for it, its knobs, and the digest of its weights."""

    name: str
    version: int
    knobs: tuple[tuple[str, Any], ...]
    weights: str
    footprint: Footprint


def identify_backend(
    name: str, weights: Path | None, accepted_licences: Collection[str], knobs: Mapping[str, Any] | None = None
) -> BackendIdentity:
    """Identity of a backend; every check of its files is made here, before anything runs.

    Raises:
        JobError: there is no such backend, its licence was not accepted, or its weights are missing.
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
