"""Backends by the name that stands in the job file; what each is, told without importing torch."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yesnt.core.errors import JobError
from yesnt.decompose.backend import Backend, Footprint, Licence, VideoBackend
from yesnt.decompose.checkpoint import Published
from yesnt.decompose.published import COSMOS, DIFFUSION_RENDERER, MARIGOLD, RGBX

Knobs = Mapping[str, Any]

EMBEDDED_WEIGHTS = Path(__file__).parent.parent / "data" / "weights" / "embedded.safetensors"
"""The weights in the package."""


def _embedded(path: Path, knobs: Knobs) -> Backend:
    from yesnt.decompose.embedded import EmbeddedBackend

    return EmbeddedBackend(path, **knobs)


def _marigold(folder: Path, knobs: Knobs) -> Backend:
    from yesnt.decompose.marigold import MarigoldBackend

    return MarigoldBackend(folder, **knobs)


def _rgbx(folder: Path, knobs: Knobs) -> Backend:
    from yesnt.decompose.rgbx import RgbxBackend

    return RgbxBackend(folder, **knobs)


def _diffusion_renderer(folder: Path, knobs: Knobs) -> VideoBackend:
    from yesnt.decompose.diffusion_renderer import DiffusionRendererBackend

    return DiffusionRendererBackend(folder, **knobs)


def _cosmos(folder: Path, knobs: Knobs) -> VideoBackend:
    from yesnt.decompose.cosmos import CosmosBackend

    return CosmosBackend(folder, **knobs)


def _embedded_footprint(path: Path, knobs: Knobs) -> Footprint:
    with path.open("rb") as file:  # a safetensors file begins with the length of its JSON header
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    return Footprint(int(header["__metadata__"]["patch"]), 16, int(knobs.get("steps", 2)), predicts_mean=True)


def _marigold_footprint(folder: Path, knobs: Knobs) -> Footprint:
    index = json.loads((folder / "model_index.json").read_text())
    patch = knobs.get("patch") or index["default_processing_resolution"]
    return Footprint(int(patch), 8, int(knobs.get("steps") or index["default_denoising_steps"]))


def _rgbx_footprint(folder: Path, knobs: Knobs) -> Footprint:
    return Footprint(int(knobs.get("patch", 768)), 8, 2 * int(knobs.get("steps", 50)))


def _diffusion_renderer_footprint(folder: Path, knobs: Knobs) -> Footprint:
    window, overlap = int(knobs.get("window", 24)), int(knobs.get("window_overlap", 6))
    return Footprint(int(knobs.get("patch", 512)), 64, 2 * int(knobs.get("steps", 20)), window, overlap)


def _cosmos_footprint(folder: Path, knobs: Knobs) -> Footprint:
    window, overlap = int(knobs.get("window", 57)), int(knobs.get("window_overlap", 8))
    return Footprint(None, 1, 2 * int(knobs.get("steps", 15)), window, overlap)


@dataclass(frozen=True)
class Entry:
    """A backend before it is opened: its licence is judged and its files are looked for before gigabytes are read.

    Attributes:
        licence: of the weights.
        version: of our code that runs it; part of the record's key.
        open: file or folder of weights and knobs to the backend.
        footprint: the same to what a call of it holds.
        knobs: names and types that the job may set for it.
        published: what its folder must hold; None: the package ships it as one file.
    """

    licence: Licence
    version: int
    open: Callable[[Path, Knobs], Backend | VideoBackend]
    footprint: Callable[[Path, Knobs], Footprint]
    knobs: Mapping[str, type] = field(default_factory=dict)
    published: Published | None = None


_LATENT = {"steps": int, "patch": int, "batch": int, "precision": str}
_VIDEO = {"steps": int, "window": int, "window_overlap": int}

ENTRIES = {
    "embedded": Entry(Licence("Apache-2.0", commercial=True), 5, _embedded, _embedded_footprint, {"steps": int}),
    "marigold": Entry(
        Licence("OpenRAIL++-M", commercial=True), 2, _marigold, _marigold_footprint, _LATENT, MARIGOLD
    ),
    "rgbx": Entry(Licence("Adobe-Research", commercial=False), 2, _rgbx, _rgbx_footprint, _LATENT, RGBX),
    "diffusion-renderer": Entry(
        Licence("NVIDIA-NonCommercial", commercial=False), 1, _diffusion_renderer, _diffusion_renderer_footprint,
        {**_VIDEO, "patch": int, "precision": str}, DIFFUSION_RENDERER,
    ),
    "diffusion-renderer-cosmos": Entry(
        Licence("NVIDIA-Open-Model", commercial=True), 1, _cosmos, _cosmos_footprint,
        {**_VIDEO, "python": str, "allow_pickle": bool, "offload": bool}, COSMOS,
    ),
}  # fmt: skip
"""Every backend by name."""

BACKENDS = tuple(ENTRIES)
"""Names that a job may use."""


def open_backend(
    name: str, weights: Path | None = None, accepted_licences: Collection[str] = (), knobs: Knobs | None = None
) -> Backend | VideoBackend:
    """Opens a backend.

    Args:
        name: one of `BACKENDS`.
        weights: local file or folder; None for what the package ships.
        accepted_licences: non-commercial licences that the user has accepted by name.
        knobs: of this backend, as the job sets them.

    Raises:
        JobError: unknown name, absent files, or a licence that forbids commercial use and was not accepted.
        MissingPartError: an optional package is not installed.
    """
    check_licence(name, accepted_licences)
    return ENTRIES[name].open(find_weights(name, weights), knobs or {})


def find_weights(name: str, weights: Path | None) -> Path:
    """The file or folder of a backend's weights, complete.

    Raises:
        JobError: it is not given, or a file is absent; says which, and where they are published.
    """
    published = ENTRIES[name].published
    if published is None:
        return weights or EMBEDDED_WEIGHTS
    if weights is None:
        raise JobError(
            f"the {name} backend has no weights of its own",
            "decompose.weights",
            "a local folder",
            f"download {published.source} and name its folder",
        )
    published.check(weights)
    return weights


def footprint(name: str, weights: Path | None = None, knobs: Knobs | None = None) -> Footprint:
    """What one call of a backend holds, without opening it."""
    return ENTRIES[name].footprint(find_weights(name, weights), knobs or {})


def check_licence(name: str, accepted_licences: Collection[str]) -> None:
    """Refuses what must not be opened; reads no file.

    Raises:
        JobError: unknown name, or a licence that forbids commercial use and was not accepted.
    """
    if name not in ENTRIES:
        raise JobError(
            f"there is no backend {name!r}",
            "decompose.backend",
            f"one of {', '.join(BACKENDS)}",
            "correct the job file",
        )
    licence = ENTRIES[name].licence
    if not licence.commercial and licence.name not in accepted_licences:
        raise JobError(
            f"the weights of {name} are under {licence.name}, which forbids commercial use",
            "decompose.backend",
            "a licence that allows it, or your consent",
            f"if your use is non-commercial, pass --accept-license '{licence.name}'",
        )
