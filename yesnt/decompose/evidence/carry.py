"""Measured materials of a keyframe taken to an earlier frame along the flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yesnt.decompose.evidence.fill import Materials, filled
from yesnt.decompose.evidence.records import FrameEvidence
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.reuse import Link, propagate_keyframe
from yesnt.decompose.settings import EnsembleSettings

F32 = NDArray[np.float32]


def carried_evidence(
    found: FrameEvidence,
    own: tuple[F32, F32],
    way: tuple[Sequence[Link], Sequence[NDArray[np.bool_]]],
    reuse: EnsembleSettings,
    plate: F32,
    settings: EvidenceSettings,
) -> FrameEvidence:
    """Materials of the earlier frame; where the flow does not reach, those of pixels that look alike (fill.py).

    What is carried was measured, so its spread stays, and it is taken however large that is: where the cameras leave
    much open the model's estimate, which the posterior holds already, is no better.

    Args:
        found: mean and std [2, H, W] and views [H, W] of the keyframe.
        own: the model's mean and standard deviation [2, H, W] in the earlier frame.
        way: flow from the earlier frame to the keyframe, in order of time, and the mattes of all these frames.
        reuse: least validity of the flow.
        plate: [H, W, 3] of the earlier frame, scene-linear.
        settings: `least_views`, and the model's errors.
    """
    links, mattes = way
    views = found.views[None]
    planes = np.concatenate([found.mean, views]), np.concatenate([found.std, np.zeros_like(views)])
    carried = propagate_keyframe(*planes, links, mattes, replace(reuse, reuse_confidence=0.0))
    count = np.where(carried.known, np.rint(carried.mean[2]), 0)
    known = count >= settings.least_views
    mean, std = (np.where(known, a[:2], b) for a, b in zip((carried.mean, carried.std), own, strict=True))
    mean, std = filled(Materials(mean, std), known, plate, mattes[0], settings)
    return FrameEvidence(mean, std, np.where(known, count, 0).astype(np.float32), {}, {})
