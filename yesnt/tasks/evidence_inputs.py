"""Inputs of the evidence of one frame: the task and `yesnt trade` measure by the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.tasks.light import LightFiles, captured_light
from yesnt.tasks.relight_inputs import RelightInputs

if TYPE_CHECKING:
    from yesnt.decompose.evidence.frame import EvidenceInputs
    from yesnt.decompose.evidence.records import View
    from yesnt.relight import RelightSettings

F32 = NDArray[np.float32]


def evidence_inputs(
    bare: RelightInputs, estimate: tuple[F32, F32], views: list[View], files: LightFiles, settings: RelightSettings
) -> EvidenceInputs:
    """What the evidence measures a frame by.

    Args:
        bare: plate in the working space, G-buffer, camera and proxy of the frame.
        estimate: mean and spread [2, H, W] of the model.
        views: pictures of the capture's cameras.
        files: of the capture light.
        settings: of relighting.
    """
    from yesnt.decompose.evidence.frame import EvidenceInputs

    mean, spread = estimate
    assert bare.proxy is not None, "the job file's check"
    surface = bare.surface(mean)
    return EvidenceInputs(
        bare.plate.color, surface, spread, views, bare.proxy, captured_light(files, surface, settings)
    )
