"""Splitting of Gaussians where the picture asks for detail, and pruning of those that show nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.gaussians.field import rotation_matrices
from yesnt.gaussians.fit_state import FITTED, FitState

FAINT = 0.04
"""Opacity below which a Gaussian is pruned."""

LARGEST = 0.08
"""Standard deviation above which a Gaussian is pruned, of the subject's height, in fields of 2500 and more."""

COARSE = 4.0
"""The same in smaller fields, times the square root of their number: about 3 times the first discs on a ball."""

SMALLEST = 0.6
"""Standard deviation below which a Gaussian is not split, in pixels at the subject."""

APART = 0.7
"""How far each half moves from the middle, in standard deviations along the longest axis."""

NARROWER = 1.7
"""By what the longest axis is divided."""


def densify(state: FitState, room: int, growth: float) -> None:
    """Prunes, splits the Gaussians of the largest mean screen gradient, and clears the sums.

    Args:
        state: changed in place; the halves of a split Gaussian start without Adam's moments.
        room: most Gaussians afterwards.
        growth: most new Gaussians, as a share of all; 0 prunes only.

    Raises:
        JobError: every Gaussian would be pruned.
    """
    keep = kept(state)
    if not keep.any():
        raise _lost(state)
    split = to_split(state, keep, min(int(growth * state.count), max(0, room - int(keep.sum()))))
    offset = _halve(state, split)
    for name in FITTED:
        values = state.values[name]
        halves = values[split].copy()
        if name == "positions":
            halves += offset
            values[split] -= offset
        state.values[name] = np.concatenate([values[keep], halves])
        for moments in (state.means, state.squares):
            moments[name][split] = 0
            moments[name] = np.concatenate([moments[name][keep], np.zeros_like(halves)])
    count = len(state.values["positions"])
    state.screen, state.seen = np.zeros(count, np.float32), np.zeros(count, np.float32)


def kept(state: FitState) -> NDArray[np.bool_]:
    """[N] Gaussians that are neither faint, nor unseen, nor far too large."""
    faint, unseen, large = _useless(state)
    return np.asarray(~(faint | unseen | large))


def _useless(state: FitState) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """[N] each: what is faint, what no view has seen since the last round, and what is far too large."""
    opacity = 1 / (1 + np.exp(-state.values["opacity_logits"].astype(np.float64)))
    largest = np.exp(state.values["log_scales"].max(axis=1))
    limit = max(LARGEST, COARSE / np.sqrt(max(state.count, 1)))
    return ~(opacity > FAINT), ~(state.seen > 0), ~(largest < limit * state.height)


def _lost(state: FitState) -> JobError:
    """Says why nothing is left of a fit."""
    faint, unseen, large = (int(mask.sum()) for mask in _useless(state))
    return JobError(
        f"A fit of a Gaussian field has lost all of its {state.count} Gaussians by step {state.step}: {faint} almost "
        f"transparent, {unseen} in no picture, {large} far larger than the subject allows",
        "gaussians and capture",
        "mattes and cameras that agree on where the subject is, and learning rates near the defaults",
        "look at the mattes and the calibration of the capture, or lower the rates in `knobs`",
    )  # fmt: skip


def to_split(state: FitState, keep: NDArray[np.bool_], most: int) -> NDArray[np.intp]:
    """Indices of the Gaussians to split, those of the largest mean gradient first."""
    largest = np.exp(state.values["log_scales"].max(axis=1))
    mean = state.screen / np.maximum(state.seen, 1)
    rank = np.where(keep & (largest > SMALLEST * state.pixel), mean, -1)
    first = np.argsort(-rank, kind="stable")[:most]
    return first[rank[first] > 0]


def _halve(state: FitState, split: NDArray[np.intp]) -> NDArray[np.float32]:
    """Narrows Gaussians along their longest axis; returns what each half moves, [S, 3]."""
    scales, rows = state.values["log_scales"], np.arange(len(split))
    longest = scales[split].argmax(axis=1)
    axes = rotation_matrices(state.values["rotations"][split])[rows, :, longest]
    offset = APART * np.exp(scales[split, longest])[:, None] * axes
    scales[split, longest] -= np.float32(np.log(NARROWER))
    return offset.astype(np.float32)
