"""Keys hold no defaults, so a default that changes must raise the version of the stages whose results it changes.

`defaults.json` holds the defaults of each stage's settings and the stage's version. New settings need no line there.
When a default changes on purpose: raise the versions, then write the file anew with
`python -m tests.planning.test_defaults`.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from yesnt.core.capture_input import CaptureCameras, EvidenceInput
from yesnt.core.material_input import DecomposeInput, MaterialInput, QuantityInput
from yesnt.core.matting_input import Matting
from yesnt.core.set_input import SetInput
from yesnt.core.shot import (
    CaptureInput,
    ExrOutput,
    FlowInput,
    GBufferInput,
    LightInput,
    PlateInput,
    ProxyInput,
)
from yesnt.core.shot import TemporalInput as Temporal
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.settings import EnsembleSettings
from yesnt.gaussians.losses import LossWeights
from yesnt.gaussians.mesh_settings import MeshSettings
from yesnt.gaussians.settings import FitSettings
from yesnt.planning.stages import STAGES
from yesnt.relight.settings import RelightSettings
from yesnt.temporal import EnergyParams
from yesnt.temporal.flow import FlowSettings

FILE = Path(__file__).with_name("defaults.json")

SETTINGS: dict[str, tuple[type, ...]] = {
    "matte": (Matting, CaptureCameras),
    "fit": (FitSettings, LossWeights),
    "mesh": (MeshSettings,),
    "decompose": (PlateInput, DecomposeInput, EnsembleSettings),
    "flow": (PlateInput, FlowInput, FlowSettings),
    "correct": (PlateInput, QuantityInput, MaterialInput),
    "evidence": (
        PlateInput,
        GBufferInput,
        ProxyInput,
        CaptureInput,
        CaptureCameras,
        EvidenceInput,
        EvidenceSettings,
        RelightSettings,
    ),
    "confidence": (Temporal,),
    "solve": (Temporal, EnergyParams),
    "bake": (SetInput, ProxyInput),
    "ground": (ProxyInput, SetInput),
    "relight": (PlateInput, GBufferInput, ProxyInput, LightInput, CaptureInput, RelightSettings, SetInput),
    "set": (PlateInput, GBufferInput, ProxyInput, LightInput, RelightSettings, SetInput),
    "composite": (ExrOutput, PlateInput),
}
"""The sections and records whose changed values enter the keys of a stage."""


def defaults_of(kind: type) -> Iterator[tuple[str, Any]]:
    """Name and default of every optional field."""
    if issubclass(kind, BaseModel):
        fields = {name: field for name, field in kind.model_fields.items() if not field.is_required()}
        yield from ((name, field.get_default(call_default_factory=True)) for name, field in fields.items())
    else:
        for field in dataclasses.fields(kind):
            if field.default is not dataclasses.MISSING:
                yield field.name, field.default


def current(stage: str) -> dict[str, Any]:
    """Version and defaults of a stage as JSON."""
    found = {f"{kind.__name__}.{name}": value for kind in SETTINGS[stage] for name, value in defaults_of(kind)}
    document = {"version": STAGES[stage].version, "defaults": found}
    return json.loads(json.dumps(document, default=dataclasses.asdict))


@pytest.mark.parametrize("stage", SETTINGS)
def test_a_changed_default_raises_its_stages_version(stage: str) -> None:
    written, now = json.loads(FILE.read_text())[stage], current(stage)
    known = written["defaults"].items()
    changed = {name: now["defaults"].get(name) for name, value in known if now["defaults"].get(name) != value}
    raised = now["version"] > written["version"]
    assert not changed, "write defaults.json anew" if raised else f"raise the version of stage {stage}: its keys alone"


def test_all_stages_with_settings_of_their_own_are_watched() -> None:
    assert set(SETTINGS) == set(STAGES) - {"view", "window", "preview"}, "window has decompose's, the others none"


if __name__ == "__main__":
    FILE.write_text(json.dumps({stage: current(stage) for stage in SETTINGS}, indent=1, sort_keys=True) + "\n")
