"""Fits a Gaussian opacity field to the pictures of one moment (docs/method.md section 2).

Arrays in, arrays out. Every step depends on the state, the pictures and the settings alone, so a fit that was
interrupted continues to the same bits, for any number of threads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.gaussians.adam import adam_step
from yesnt.gaussians.densify import densify
from yesnt.gaussians.fit_state import FITTED, FitState
from yesnt.gaussians.losses import Losses, LossWeights, view_losses
from yesnt.gaussians.random_order import keyed_generator
from yesnt.gaussians.rasterise import backpropagate, pinhole_of, rasterise
from yesnt.gaussians.settings import FitSettings
from yesnt.gaussians.targets import INSIDE, Target
from yesnt.gaussians.unproject import FieldGradient

GAIN = 0.02
"""dB by which the held-out PSNR must rise for a look to count as a gain."""

SLOWEST = 0.2
"""What remains of the learning rates other than the positions'."""

HIGHER = 0.1
"""Learning rate of the harmonics above degree 0, of theirs."""


@dataclass(frozen=True)
class Progress:
    """A fit at a look.

    Attributes:
        step: steps done.
        count: Gaussians.
        losses: of the last step's view.
        psnr: of the held-out cameras inside the matte, dB in the field's colour space; NaN without any.
        done: whether the fit has ended.
    """

    step: int
    count: int
    losses: Losses
    psnr: float
    done: bool


@dataclass(frozen=True)
class Pictures:
    """The targets of a fit at both resolutions, in a fixed order of cameras."""

    whole: Sequence[Target]
    half: Sequence[Target]

    @classmethod
    def of(cls, targets: Sequence[Target]) -> Pictures:
        """Halves every picture once."""
        return cls(targets, [target.halved() for target in targets])


def fit(
    state: FitState, targets: Sequence[Target], held_out: Sequence[Target], settings: FitSettings, frame: int = 0
) -> Iterator[Progress]:
    """Continues a fit to its end; yields at every look, between which the state may be kept.

    Args:
        state: changed in place; `FitState.of(field, ...)` starts anew.
        targets: pictures that are fitted.
        held_out: pictures that only measure.
        settings: of the fit.
        frame: number of the frame; keys the order of cameras together with the seed.
    """
    pictures, losses = Pictures.of(targets), None
    while True:
        stop = min((state.step // settings.check + 1) * settings.check, settings.steps)
        while state.step < stop:
            losses = take_step(state, pictures, settings, frame)
        if losses is None:
            return
        psnr = held_out_psnr(state, held_out, settings.near)
        gained = psnr > state.best + GAIN
        state.best, state.stale = (psnr, 0) if gained else (state.best, state.stale + 1)
        done = state.step >= settings.steps or finished_early(state, psnr, settings)
        yield Progress(state.step, state.count, losses, psnr, done)
        if done:
            return


def finished_early(state: FitState, psnr: float, settings: FitSettings) -> bool:
    """Whether the quality is reached, or has not risen for a while after the last splitting."""
    reached = settings.stop_psnr is not None and psnr >= settings.stop_psnr
    settled = state.step > settings.split_until * settings.steps
    return reached or (settled and 0 < settings.patience <= state.stale)


def camera_of_step(step: int, count: int, seed: int, frame: int) -> int:
    """Which of `count` cameras a step looks at: each once in a random order, then again in another one."""
    return int(keyed_generator(seed, frame, step // count).permutation(count)[step % count])


def take_step(state: FitState, pictures: Pictures, settings: FitSettings, frame: int) -> Losses:
    """One step: render a camera, compare, move the Gaussians; every so often split and prune."""
    share = state.step / settings.steps
    targets = pictures.half if share < settings.half else pictures.whole
    target = targets[camera_of_step(state.step, len(targets), settings.seed, frame)]
    pinhole = pinhole_of(target.view, state.values["positions"].mean(axis=0, dtype=np.float64), settings.near)
    arrays = state.arrays
    raster = rasterise(arrays, pinhole)
    weights = settings.weights if share >= settings.geometry_from else _flat(settings.weights)
    losses, gradient = view_losses(raster.images, target, weights, pinhole.reference_z, state.height)
    _move(state, backpropagate(arrays, raster, gradient), settings, share)
    state.step += 1
    if state.step % settings.every == 0:
        growing = settings.split_from <= share <= settings.split_until
        densify(state, settings.most, settings.growth if growing else 0.0)
    return losses


def held_out_psnr(state: FitState, targets: Sequence[Target], near: float) -> float:
    """PSNR over all pixels of the pictures that show the subject alone, dB; NaN without any."""
    squares = [squared_errors(state, target, near) for target in targets]
    return float(-10 * np.log10(max(float(np.concatenate(squares).mean()), 1e-12))) if squares else float("nan")


def squared_errors(state: FitState, target: Target, near: float) -> NDArray[np.float32]:
    """[P, 3] squared differences from a picture at the pixels that show the subject alone."""
    middle = state.values["positions"].mean(axis=0, dtype=np.float64)
    images = rasterise(state.arrays, pinhole_of(target.view, middle, near)).images
    inside = target.matte > INSIDE
    return np.asarray((np.clip(np.moveaxis(images[:3], 0, -1), 0, 1) - target.color)[inside] ** 2)


def _flat(weights: LossWeights) -> LossWeights:
    """The losses of colour and coverage alone."""
    return LossWeights(ssim=weights.ssim, matte=weights.matte, distortion=0, consistency=0, depth=0, normal=0)


def _move(state: FitState, gradient: FieldGradient, settings: FitSettings, share: float) -> None:
    """Adam's step of all arrays, and the least thickness."""
    decay = settings.last_rate**share
    slow = max(decay, SLOWEST)
    harmonics = np.full(state.values["harmonics"].shape[1:], HIGHER * settings.color_rate)
    harmonics[0] = settings.color_rate
    rates = {
        "positions": settings.position_rate * state.height * decay, "log_scales": settings.scale_rate * slow,
        "rotations": settings.rotation_rate * slow, "opacity_logits": settings.opacity_rate * slow,
        "harmonics": harmonics * slow,
    }  # fmt: skip
    for name in FITTED:
        moments = state.means[name], state.squares[name]
        adam_step(state.values[name], getattr(gradient, name), moments, np.asarray(rates[name]), state.step + 1)
    thinnest = np.float32(np.log(settings.thinnest * state.pixel))
    np.maximum(state.values["log_scales"], thinnest, out=state.values["log_scales"])
    state.screen += gradient.screen
    state.seen += gradient.screen > 0
