"""Which backends there are: their identity without loading them, and the loading itself. Light to import."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from yesnt.errors import JobError

if TYPE_CHECKING:
    from yesnt.decompose.backend import Backend

EMBEDDED_WEIGHTS = Path(__file__).parent.parent / "data" / "weights" / "embedded.safetensors"
"""The weights in the package."""


@dataclass(frozen=True)
class BackendIdentity:
    """What a decomposition's result depends on beside its settings.

    Attributes:
        name: the word in the job file.
        weights: digest of the weights file.
    """

    name: str
    weights: str


def identify_backend(name: str, weights: str | None) -> BackendIdentity:
    """Name and weights digest of a backend, read without importing torch.

    Raises:
        JobError: there is no such backend, or its weights are missing.
    """
    path = _weights_path(name, weights)
    with path.open("rb") as stream:
        return BackendIdentity(name, hashlib.file_digest(stream, "sha256").hexdigest())


def open_backend(name: str, weights: str | None) -> Backend:
    """Loads a backend.

    Raises:
        JobError: as `identify_backend`.
        CorruptError: the weights are damaged.
    """
    from yesnt.decompose.embedded import EmbeddedBackend

    return EmbeddedBackend(_weights_path(name, weights))


def _weights_path(name: str, weights: str | None) -> Path:
    if name != "embedded":
        raise JobError(f"No backend {name!r}", "key decompose.backend", "embedded", "check its spelling")
    path = EMBEDDED_WEIGHTS if weights is None else Path(weights).expanduser()
    if not path.is_file():
        raise JobError("The weights are missing", str(path), "a safetensors file", "reinstall or set decompose.weights")
    return path
