"""From pooled likelihoods to roughness and metallic: priors, posterior, its mean and standard deviation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from yesnt.decompose.confidence import LARGEST_STD
from yesnt.decompose.evidence.settings import (
    HALF_METALS,
    METALLIC_PRIOR,
    EvidenceSettings,
    metallic_levels,
    roughness_levels,
)

F32 = NDArray[np.float32]
Float = NDArray[np.floating]


def log_prior(mean: Float, spread: Float, settings: EvidenceSettings) -> Float:
    """Log prior [N, R, M] of every candidate: the model's estimate as a Gaussian, times that of surfaces in general.

    Args:
        mean: [N, 2] roughness and metallic of the model.
        spread: [N, 2] standard deviation of its members.
        settings: `roughness_error` and `metallic_error` are what the members do not know of their own error.
    """
    errors = np.array([settings.roughness_error, settings.metallic_error])
    variance = spread.astype(np.float64) ** 2 + errors**2
    terms = []
    for i, (levels, share) in enumerate(_levels(settings)):
        distance = (levels[None] - mean[:, i, None]) ** 2 / variance[:, i, None]
        terms.append(np.log(share)[None] - 0.5 * distance)
    return np.asarray(terms[0][:, :, None] + terms[1][:, None, :])


def _edges(levels: Float) -> Float:
    """Borders [N + 1] of the cells of levels [N] that cover [0, 1]."""
    return np.concatenate([[0.0], 0.5 * (levels[1:] + levels[:-1]), [1.0]])


def _levels(settings: EvidenceSettings) -> tuple[tuple[Float, Float], tuple[Float, Float]]:
    """Levels of roughness and of metallic, each with the share of surfaces in their cells."""
    rough = roughness_levels(settings)
    every = np.diff(_edges(rough))  # every roughness is as likely
    return (rough, every), (metallic_levels(settings), metallic_shares(settings))


def metallic_shares(settings: EvidenceSettings) -> Float:
    """Share of surfaces in the cell of each level of metallic: a Beta distribution and an even one."""
    edges = _edges(metallic_levels(settings))
    return np.asarray((1 - HALF_METALS) * np.diff(beta.cdf(edges, *METALLIC_PRIOR)) + HALF_METALS * np.diff(edges))


def posterior(cost: Float, prior: Float, settings: EvidenceSettings) -> Float:
    """Probability of every candidate [N, R, M], from the pooled minus log likelihood and the log prior."""
    exponent = prior - np.asarray(cost, dtype=np.float64) / settings.temper
    exponent -= exponent.max(axis=(1, 2), keepdims=True)
    probability = np.exp(exponent)
    return np.asarray(probability / probability.sum(axis=(1, 2), keepdims=True))


def moments(probability: Float, settings: EvidenceSettings) -> tuple[F32, F32]:
    """Mean and standard deviation [N, 2] of roughness and metallic.

    A level stands for the values of its cell, so that the variance within the cells is a part of the spread; what is
    wrong for all candidates together is added (`unknown`, `stretch`).
    """
    mean, deviation = [], []
    shares = probability.sum(2), probability.sum(1)
    for (levels, _), share in zip(_levels(settings), shares, strict=True):
        middle = share @ levels
        mean.append(middle)
        within = share @ (np.diff(_edges(levels)) ** 2 / 12)
        deviation.append(np.sqrt(np.maximum(share @ levels**2 - middle**2, 0) + within))
    spread = settings.stretch * np.hypot(np.stack(deviation, axis=1), [settings.unknown, 0])
    std = np.minimum(spread, LARGEST_STD)
    return np.clip(np.stack(mean, axis=1), 0, 1).astype(np.float32), std.astype(np.float32)


def estimate(cost: Float, model: Float, spread: Float, settings: EvidenceSettings) -> tuple[F32, F32]:
    """Mean and standard deviation [N, 2] that the cameras leave of the model's.

    Where the cameras tell nothing about metallic the model's estimate stands: what is usual of surfaces
    (`metallic_shares`) decides between candidates that the cameras left, and moves no estimate by itself.

    Args:
        cost: [N, R, M] pooled minus log likelihood.
        model: [N, 2] estimate of the model.
        spread: [N, 2] standard deviation of its members.
        settings: of the evidence.
    """
    mean, deviation = moments(posterior(cost, log_prior(model, spread, settings), settings), settings)
    told, own = information(cost, settings), model[:, 1].astype(np.float64)
    moved = mean[:, 1] - own
    variance = told * deviation[:, 1].astype(np.float64) ** 2 + told * (1 - told) * moved**2  # of a mixture of both
    variance += (1 - told) * (spread[:, 1].astype(np.float64) ** 2 + settings.metallic_error**2)
    mean[:, 1], deviation[:, 1] = own + told * moved, np.minimum(np.sqrt(variance), LARGEST_STD)
    return mean, deviation


def information(cost: Float, settings: EvidenceSettings) -> Float:
    """What the cameras tell of metallic [N], from 0 to 1: 1 - exp(-8 D).

    D is the Kullback-Leibler divergence of the normalised likelihood of metallic from an even one.
    """
    cells = [np.diff(_edges(levels)) for levels, _ in _levels(settings)]
    even = np.log(cells[0])[:, None] + np.log(cells[1])
    share = posterior(cost, even[None], settings).sum(axis=1)
    divergence = (share * np.log(np.maximum(share, _LEAST) / cells[1])).sum(axis=1)
    return np.asarray(1 - np.exp(-8 * np.maximum(divergence, 0)))


_LEAST = 1e-30  # a share of 0 has no logarithm, and counts nothing
