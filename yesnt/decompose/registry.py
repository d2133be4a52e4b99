"""Backends by the name that stands in the job file."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from yesnt.decompose.backend import Backend, Licence
from yesnt.decompose.checkpoint import Published
from yesnt.errors import JobError


def _embedded(folder: Path | None) -> Backend:
    from yesnt.decompose.embedded import EmbeddedBackend

    return EmbeddedBackend() if folder is None else EmbeddedBackend(folder)


def _marigold(folder: Path | None) -> Backend:
    from yesnt.decompose.marigold import MARIGOLD, MarigoldBackend

    return MarigoldBackend(_given(folder, "marigold", MARIGOLD))


def _rgbx(folder: Path | None) -> Backend:
    from yesnt.decompose.rgbx import RGBX, RgbxBackend

    return RgbxBackend(_given(folder, "rgbx", RGBX))


def _given(folder: Path | None, name: str, published: Published) -> Path:
    """The folder, which a backend without weights of its own must be given."""
    if folder is None:
        raise JobError(
            f"the {name} backend has no weights of its own",
            "decompose.weights",
            "a local folder",
            f"download {published.source} and name its folder",
        )
    return folder


@dataclass(frozen=True)
class _Entry:
    """A backend before it is opened: its licence is judged before gigabytes are read."""

    licence: Licence
    open: Callable[[Path | None], Backend]


_ENTRIES = {
    "embedded": _Entry(Licence("Apache-2.0", commercial=True), _embedded),
    "marigold": _Entry(Licence("OpenRAIL++-M", commercial=True), _marigold),
    "rgbx": _Entry(Licence("Adobe-Research", commercial=False), _rgbx),
}

BACKENDS = tuple(_ENTRIES)
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
    check_licence(name, accepted_licences)
    return _ENTRIES[name].open(weights)


def check_licence(name: str, accepted_licences: Collection[str]) -> None:
    """Refuses what must not be opened; reads no file.

    Raises:
        JobError: unknown name, or a licence that forbids commercial use and was not accepted.
    """
    if name not in _ENTRIES:
        raise JobError(
            f"there is no backend {name!r}",
            "decompose.backend",
            f"one of {', '.join(BACKENDS)}",
            "correct the job file",
        )
    licence = _ENTRIES[name].licence
    if not licence.commercial and licence.name not in accepted_licences:
        raise JobError(
            f"the weights of {name} are under {licence.name}, which forbids commercial use",
            "decompose.backend",
            "a licence that allows it, or your consent",
            f"if your use is non-commercial, pass --accept-license '{licence.name}'",
        )
