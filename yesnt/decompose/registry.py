"""Backends by the name that stands in the job file."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from yesnt.decompose.backend import Backend
from yesnt.errors import JobError


def _embedded(folder: Path | None) -> Backend:
    from yesnt.decompose.embedded import EmbeddedBackend

    return EmbeddedBackend() if folder is None else EmbeddedBackend(folder)


def _marigold(folder: Path | None) -> Backend:
    from yesnt.decompose.marigold import MARIGOLD, MarigoldBackend

    if folder is None:
        raise JobError(
            "the marigold backend has no weights of its own",
            "decompose.weights",
            "a local folder",
            f"download {MARIGOLD.source} and name its folder",
        )
    return MarigoldBackend(folder)


_OPENERS: dict[str, Callable[[Path | None], Backend]] = {"embedded": _embedded, "marigold": _marigold}

BACKENDS = tuple(_OPENERS)
"""Names that a job may use."""


def open_backend(name: str, weights: Path | None = None, accepted_licences: Collection[str] = ()) -> Backend:
    """Opens a backend.

    Args:
        name: one of `BACKENDS`.
        weights: local file or folder; None for what the package ships.
        accepted_licences: non-commercial licences that the user has accepted by name.

    Raises:
        JobError: unknown name, absent files, or a licence that forbids commercial use and was not accepted.
        MissingPartError: an optional package is not installed.
    """
    if name not in _OPENERS:
        raise JobError(
            f"there is no backend {name!r}",
            "decompose.backend",
            f"one of {', '.join(BACKENDS)}",
            "correct the job file",
        )
    backend = _OPENERS[name](weights)
    licence = backend.licence
    if not licence.commercial and licence.name not in accepted_licences:
        raise JobError(
            f"the weights of {name} are under {licence.name}, which forbids commercial use",
            "decompose.backend",
            "a licence that allows it, or your consent",
            f"if your use is non-commercial, pass --accept-license '{licence.name}'",
        )
    return backend
