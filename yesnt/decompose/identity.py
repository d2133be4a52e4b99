"""What a decomposition's result depends on beside its settings, told without importing torch."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from yesnt.decompose.checkpoint import Published
from yesnt.decompose.registry import check_licence
from yesnt.errors import JobError

EMBEDDED_WEIGHTS = Path(__file__).parent.parent / "data" / "weights" / "embedded.safetensors"
"""The weights in the package."""


@dataclass(frozen=True)
class BackendIdentity:
    """Name of a backend in the job file, and digest of its weights."""

    name: str
    weights: str


def identify_backend(name: str, weights: str | None, accepted_licences: Collection[str]) -> BackendIdentity:
    """Name and weights digest of a backend.

    Raises:
        JobError: there is no such backend, its licence was not accepted, or its weights are missing.
    """
    check_licence(name, accepted_licences)
    path = EMBEDDED_WEIGHTS if weights is None and name == "embedded" else weights
    if path is None or not Path(path).expanduser().exists():
        raise JobError(
            f"The weights of {name} are missing",
            str(path or "key decompose.weights"),
            "a local file or folder of safetensors",
            "reinstall the package, or set decompose.weights",
        )
    found = Path(path).expanduser()
    if found.is_dir():
        return BackendIdentity(name, Published(name, "", ()).digest(found))
    with found.open("rb") as stream:
        return BackendIdentity(name, hashlib.file_digest(stream, "sha256").hexdigest())
