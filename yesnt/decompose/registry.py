"""Table of the decomposition backends by the name in the job file. Importing it does not import torch.

A new backend is one file with a class that follows a protocol of `yesnt.decompose.backend`, and one row of `ENTRIES`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

from yesnt.core.errors import JobError
from yesnt.decompose.backend import Backend, Footprint, Licence, VideoBackend
from yesnt.decompose.checkpoint import Published
from yesnt.decompose.published import COSMOS, DIFFUSION_RENDERER, MARIGOLD, RGBX
from yesnt.decompose.settings import EnsembleSettings

Knobs: TypeAlias = Mapping[str, Any]

EMBEDDED_WEIGHTS = Path(__file__).parent.parent / "data" / "weights" / "embedded.safetensors"
"""The weights in the package."""


@dataclass(frozen=True)
class KnobSpec:
    """Declaration of one setting of a backend that a job may give below `decompose.knobs`.

    Attributes:
        default: value where the job gives none; its type is the type of the knob.
        low: least value of an integer.
        high: largest value of an integer; None: unbounded.
        choices: accepted words of a text; none: any.
    """

    default: int | str | bool
    low: int = 1
    high: int | None = None
    choices: tuple[str, ...] = ()

    def check(self, name: str, value: object) -> None:
        """Checks a value that a job gives.

        Raises:
            JobError: the type is another, or the value is out of range; states what is accepted.
        """
        if type(value) is not type(self.default) or not self._accepts(value):
            raise JobError(f"The knob {name!r} is {value!r}", "key decompose.knobs", self._expected(), "correct it")

    def _accepts(self, value: Any) -> bool:
        if type(value) is int:
            return self.low <= value and (self.high is None or value <= self.high)
        return not self.choices or value in self.choices

    def _expected(self) -> str:
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if type(self.default) is not int:
            return f"a {type(self.default).__name__}"
        return f"an int of at least {self.low}" if self.high is None else f"an int in {self.low} .. {self.high}"


@dataclass(frozen=True)
class Entry:
    """A row of the table: everything that a job's checks and plan need before the backend is opened.

    Attributes:
        implementation: "module:class" of the backend; the module is imported when the backend is opened. The class is
            called with the path of the weights and every knob by name.
        licence: terms of the weights.
        version: version of our code for this backend; part of the key of a frame's record, raised when results change.
        footprint: maps the path of the weights and all knobs, defaults included, to the size of one call.
        knobs: declared settings by name.
        published: files that the folder of weights must hold; None: the weights are a single file in the package.
        gpu: the network is made for a GPU; a cluster that has GPU workers runs it on these alone.
        samples: members that are drawn where the job does not say and sets no tolerance. Two, a pair of opposite noise,
            are enough for a backend that returns the expectation of its draws (docs/trade.md).
    """

    implementation: str
    licence: Licence
    version: int
    footprint: Callable[[Path, Knobs], Footprint]
    knobs: Mapping[str, KnobSpec] = field(default_factory=dict)
    published: Published | None = None
    gpu: bool = False
    samples: int = EnsembleSettings.samples

    def resolve(self, knobs: Knobs) -> dict[str, Any]:
        """Returns every declared knob with the job's value or the default.

        Raises:
            JobError: a knob is not declared, or its value is not accepted.
        """
        for name, value in knobs.items():
            if name not in self.knobs:
                known = ", ".join(self.knobs) or "none"
                raise JobError(f"The backend has no knob {name!r}", "key decompose.knobs", known, "correct it")
            self.knobs[name].check(name, value)
        return {name: spec.default for name, spec in self.knobs.items()} | dict(knobs)

    def load(self) -> Callable[..., Any]:
        """Imports the module and returns the class of the backend."""
        module, name = self.implementation.split(":")
        backend: Callable[..., Any] = getattr(import_module(module), name)
        return backend


def _embedded_footprint(path: Path, knobs: Knobs) -> Footprint:
    with path.open("rb") as file:  # a safetensors file begins with the length of its JSON header
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    return Footprint(int(header["__metadata__"]["patch"]), 16, knobs["steps"], predicts_mean=True)


def _marigold_footprint(folder: Path, knobs: Knobs) -> Footprint:
    index = json.loads((folder / "model_index.json").read_text())
    patch = knobs["patch"] or index["default_processing_resolution"]
    return Footprint(int(patch), 8, int(knobs["steps"] or index["default_denoising_steps"]))


_PRECISION = KnobSpec("auto", choices=("auto", "float32", "float16", "bfloat16"))

ENTRIES: dict[str, Entry] = {
    "embedded": Entry(
        "yesnt.decompose.embedded:EmbeddedBackend",
        Licence("Apache-2.0", commercial=True),
        version=5,
        footprint=_embedded_footprint,
        knobs={"steps": KnobSpec(1, high=4)},
        samples=2,
    ),
    "marigold": Entry(
        "yesnt.decompose.marigold:MarigoldBackend",
        Licence("OpenRAIL++-M", commercial=True),
        version=2,
        footprint=_marigold_footprint,
        # 0 of steps and patch: the value that the checkpoint states.
        knobs={"steps": KnobSpec(0, low=0), "patch": KnobSpec(0, low=0), "batch": KnobSpec(1), "precision": _PRECISION},
        published=MARIGOLD,
        gpu=True,
    ),
    "rgbx": Entry(
        "yesnt.decompose.rgbx:RgbxBackend",
        Licence("Adobe-Research", commercial=False),
        version=2,
        footprint=lambda folder, knobs: Footprint(knobs["patch"], 8, 2 * knobs["steps"]),
        knobs={"steps": KnobSpec(50), "patch": KnobSpec(768), "batch": KnobSpec(1), "precision": _PRECISION},
        published=RGBX,
        gpu=True,
    ),
    "diffusion-renderer": Entry(
        "yesnt.decompose.diffusion_renderer:DiffusionRendererBackend",
        Licence("NVIDIA-NonCommercial", commercial=False),
        version=1,
        footprint=lambda folder, knobs: Footprint(
            knobs["patch"], 64, 2 * knobs["steps"], knobs["window"], knobs["window_overlap"]
        ),
        knobs={
            "steps": KnobSpec(20), "patch": KnobSpec(512), "window": KnobSpec(24),
            "window_overlap": KnobSpec(6, low=0), "precision": _PRECISION,
        },
        published=DIFFUSION_RENDERER,
        gpu=True,
    ),
    "diffusion-renderer-cosmos": Entry(
        "yesnt.decompose.cosmos:CosmosBackend",
        Licence("NVIDIA-Open-Model", commercial=True),
        version=1,
        footprint=lambda folder, knobs: Footprint(
            None, 1, 2 * knobs["steps"], knobs["window"], knobs["window_overlap"]
        ),
        knobs={
            "steps": KnobSpec(15), "window": KnobSpec(57), "window_overlap": KnobSpec(8, low=0),
            "python": KnobSpec(""), "allow_pickle": KnobSpec(False), "offload": KnobSpec(True),
        },
        published=COSMOS,
        gpu=True,
    ),
}  # fmt: skip
"""Every backend by the name in the job file."""


def open_backend(
    name: str, weights: Path | None = None, accepted_licences: Collection[str] = (), knobs: Knobs | None = None
) -> Backend | VideoBackend:
    """Opens a backend: imports its module and loads its weights.

    Args:
        name: key of `ENTRIES`.
        weights: local file or folder; None: the file in the package.
        accepted_licences: names of non-commercial licences that the user has accepted.
        knobs: settings that the job gives for this backend.

    Raises:
        JobError: the name is unknown, a file is missing, a knob is not accepted, or the licence forbids commercial use
            and was not accepted.
        MissingPartError: an optional package is not installed.
    """
    check_licence(name, accepted_licences)
    entry = ENTRIES[name]
    path, settings = find_weights(name, weights), entry.resolve(knobs or {})
    backend: Backend | VideoBackend = entry.load()(path, **settings)
    return backend


def find_weights(name: str, weights: Path | None) -> Path:
    """Returns the path of a backend's weights after a check that every file is there.

    Raises:
        JobError: no folder is given, or a file is missing; names the file and where the weights are published.
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
    """Returns the size of one call of a backend without opening it.

    Raises:
        JobError: a file is missing, or a knob is not accepted.
    """
    entry = ENTRIES[name]
    return entry.footprint(find_weights(name, weights), entry.resolve(knobs or {}))


def check_licence(name: str, accepted_licences: Collection[str]) -> None:
    """Checks the name and the licence; reads no file.

    Raises:
        JobError: the name is unknown, or the licence forbids commercial use and was not accepted.
    """
    if name not in ENTRIES:
        raise JobError(
            f"there is no backend {name!r}",
            "decompose.backend",
            f"one of {', '.join(ENTRIES)}",
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
