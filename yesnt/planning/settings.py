"""Makes the kernels' frozen settings from the sections of the job file; an unknown knob is refused by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from yesnt.core.errors import JobError
from yesnt.core.job_part import Knob
from yesnt.core.shot import Shot

if TYPE_CHECKING:
    from yesnt.decompose.evidence.settings import EvidenceSettings
    from yesnt.decompose.registry import KnobSpec
    from yesnt.decompose.settings import EnsembleSettings
    from yesnt.gaussians.mesh_settings import MeshSettings
    from yesnt.gaussians.settings import FitSettings
    from yesnt.relight.settings import RelightSettings
    from yesnt.temporal.flow import FlowSettings
    from yesnt.temporal.params import EnergyParams

T = TypeVar("T")


def ensemble_settings(shot: Shot) -> EnsembleSettings:
    """Members, overlap, tolerance of the decomposition."""
    from yesnt.decompose.settings import EnsembleSettings

    own = backend_knobs(shot)
    given = {name: value for name, value in shot.decompose.knobs.items() if name not in own}
    known = (*_fields(EnsembleSettings), *_knobs_of(shot.decompose.backend))
    return _build("decompose.knobs", EnsembleSettings, {"samples": _members(shot), **given}, known)


def _members(shot: Shot) -> int:
    """Members K as the job says, else as the backend's entry does; with a tolerance K is only the most of a patch."""
    from yesnt.decompose.registry import ENTRIES
    from yesnt.decompose.settings import EnsembleSettings

    if shot.decompose.samples is not None:
        return shot.decompose.samples
    known = shot.decompose.backend in ENTRIES and "tolerance" not in shot.decompose.knobs
    return ENTRIES[shot.decompose.backend].samples if known else EnsembleSettings().samples


def backend_knobs(shot: Shot) -> dict[str, Knob]:
    """The part of the decomposition's knobs that its backend takes, by its entry in the registry."""
    known = _knobs_of(shot.decompose.backend)
    own = {name: value for name, value in shot.decompose.knobs.items() if name in known}
    for name, value in own.items():
        known[name].check(name, value)
    return own


def weights_path(root: str, shot: Shot) -> Path | None:
    """Where the job says that its weights lie, from the job file's folder; None: those of the package."""
    weights = shot.decompose.weights
    return None if weights is None else Path(root) / Path(weights).expanduser()


def _knobs_of(backend: str) -> Mapping[str, KnobSpec]:
    """Declared knobs of a backend; none of an unknown backend, which the preflight refuses."""
    from yesnt.decompose.registry import ENTRIES

    return ENTRIES[backend].knobs if backend in ENTRIES else {}


def evidence_settings(shot: Shot) -> EvidenceSettings:
    """How the capture's cameras are weighed."""
    from yesnt.decompose.evidence.settings import EvidenceSettings

    return _build("evidence.knobs", EvidenceSettings, shot.evidence.knobs, _fields(EvidenceSettings))


def flow_settings(shot: Shot) -> FlowSettings:
    """Method and thresholds of the optical flow."""
    from yesnt.temporal.flow import FlowSettings

    return _build("flow.knobs", FlowSettings, shot.flow.knobs, _fields(FlowSettings))


def energy_params(shot: Shot) -> EnergyParams:
    """Parameters of the temporal energy."""
    from yesnt.temporal.params import EnergyParams

    return _build("temporal.knobs", EnergyParams, shot.temporal.knobs, _fields(EnergyParams))


def relight_settings(shot: Shot) -> RelightSettings:
    """What the quality means for relighting, with the knobs that the job sets by name."""
    from yesnt.relight.settings import RelightSettings, refuse_former_names

    def build(**knobs: Any) -> RelightSettings:
        return RelightSettings.from_quality(shot.quality, **knobs)

    refuse_former_names(shot.relight)
    return _build("relight", build, shot.relight, _fields(RelightSettings))


def fit_settings(shot: Shot) -> FitSettings:
    """How Gaussian fields are fitted; `seed` is the job's."""
    from yesnt.gaussians.losses import LossWeights
    from yesnt.gaussians.settings import FitSettings

    def build(**knobs: Any) -> FitSettings:
        weights = {name: knobs.pop(name) for name in _fields(LossWeights) if name in knobs}
        return FitSettings(**knobs, weights=LossWeights(**weights), seed=shot.seed)

    known = [name for name in _fields(FitSettings) if name not in ("weights", "seed")]
    return _gaussian_settings(shot, build, (*known, *_fields(LossWeights)))


def mesh_settings(shot: Shot) -> MeshSettings:
    """How proxy meshes are extracted from Gaussian fields."""
    from yesnt.gaussians.mesh_settings import MeshSettings

    return _gaussian_settings(shot, MeshSettings, _fields(MeshSettings))


def _gaussian_settings(shot: Shot, make: Callable[..., T], own: tuple[str, ...]) -> T:
    """Settings from those of the knobs that they know; the others belong to other settings, or to none."""
    from yesnt.gaussians.losses import LossWeights
    from yesnt.gaussians.mesh_settings import MeshSettings
    from yesnt.gaussians.settings import FitSettings

    knobs = shot.gaussians.knobs if shot.gaussians else {}
    known = dict.fromkeys((*_fields(FitSettings), *_fields(LossWeights), *_fields(MeshSettings)))
    taken = tuple(name for name in known if name not in ("weights", "seed"))
    given = {name: value for name, value in knobs.items() if name in own or name not in taken}
    return _build("gaussians.knobs", make, given, taken)


def _fields(record: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(record))


def _build(where: str, make: Callable[..., T], knobs: Mapping[str, Knob], known: tuple[str, ...]) -> T:
    unknown = sorted(set(knobs) - set(known))
    if unknown:
        raise JobError(
            f"Unknown knob {unknown[0]!r}", f"key {where}", f"one of {', '.join(known)}", "check its spelling"
        )
    try:
        return make(**knobs)
    except (ValueError, TypeError) as error:
        raise JobError(
            f"A knob has a value that cannot be used ({error})", f"key {where}", "see the message", "correct it"
        ) from error
