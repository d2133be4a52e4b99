"""Temporal metrics: stability of videos against the truth, and flow against true flow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from yesnt.metrics.definitions import Metric, named
from yesnt.metrics.image import decibels
from yesnt.metrics.perceptual import PerceptualNet
from yesnt.temporal.flow import sample_next

Video = NDArray[np.floating]
Mask = NDArray[np.bool_]


def tpsnr_diff(video: Video, truth: Video, matte: Mask) -> float:
    """PSNR of changes against true changes, dB, pooled over pairs; display videos [T, H, W, 3], matte [T, H, W]."""
    both = matte[:-1] & matte[1:]
    error = (np.diff(video, axis=0) - np.diff(truth, axis=0))[both]
    return decibels(float(np.mean(np.square(error, dtype=float)))) if error.size else math.nan


def tpsnr_warp(video: Video, flow: NDArray[np.float32], seen: Mask, matte: Mask) -> float:
    """PSNR of the next frame, fetched along the flow, against this one, dB, pooled over pairs.

    Args:
        video: [T, H, W, 3] display.
        flow: [T-1, H, W, 2] pixels, t to t+1.
        seen: [T-1, H, W] where the point is visible in both frames.
        matte: [T, H, W].
    """
    total, count = 0.0, 0
    for t in range(len(video) - 1):
        fetched, valid = sample_next(video[t + 1].astype(np.float32), flow[t], matte[t], matte[t + 1])
        error = (fetched - video[t])[valid & seen[t]]
        total, count = total + float(np.square(error, dtype=float).sum()), count + error.size
    return decibels(total / count) if count else math.nan


def path_length(video: Video, net: PerceptualNet) -> NDArray[np.float64]:
    """Perceptual distance of consecutive frames [T-1] of a display video over black."""
    features = [net.features(picture) for picture in video]
    return np.array([net.between(a, b) for a, b in pairwise(features)])


def measure_lengths(lengths: Sequence[float] | NDArray[np.float64], truth: NDArray[np.float64]) -> list[Metric]:
    """PPL and tLP from the distances of consecutive frames of a video and of the truth."""
    own = np.asarray(lengths, float)
    return [named("ppl", float(own.mean())), named("tlp", 100 * float(np.abs(own - truth).mean()))]


def measure_flow(
    flow: NDArray[np.float32], truth: NDArray[np.float32], valid: Mask, seen: Mask, matte: Mask
) -> list[Metric]:
    """Flow and validity against truth.

    Args:
        flow: [..., H, W, 2] pixels.
        truth: [..., H, W, 2] pixels.
        valid: [..., H, W] where our validity accepts the flow.
        seen: [..., H, W] where the point is visible in the next frame.
        matte: [..., H, W] of this frame.
    """
    length = np.linalg.norm(np.asarray(flow, float) - truth, axis=-1)[matte & seen]
    called, hidden = (~valid)[matte], (~seen)[matte]
    both = int((called & hidden).sum())
    return [
        named("epe", float(length.mean()) if length.size else math.nan),
        named("occlusion_precision", both / int(called.sum()) if called.any() else math.nan),
        named("occlusion_recall", both / int(hidden.sum()) if hidden.any() else math.nan),
    ]
