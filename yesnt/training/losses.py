"""Losses of the embedded model: the energy score of samples, and the error of the expected material."""

from __future__ import annotations

import torch
from torch.nn import functional as F


def energy_score(first: torch.Tensor, second: torch.Tensor, clean: torch.Tensor, matte: torch.Tensor) -> torch.Tensor:
    """Energy score of two independent samples against the ground truth, per pixel and of local means.

    E|X - y| - E|X - X'| / 2 (Gneiting & Raftery 2007, eq. 21) is a strictly proper scoring rule: its expectation is
    least if and only if X has the distribution of y. The network thus learns to sample with the right spread in a
    single step (distributional diffusion, De Bortoli et al. 2025).

    Args:
        first: [B, 2, P, P] a sample.
        second: [B, 2, P, P] another sample.
        clean: [B, 2, P, P] ground truth.
        matte: [B, 1, P, P] weights of the pixels.

    Returns:
        Scalar; the sum over windows of 1, 4, 16 and P pixels with weights 1, 0.5, 0.5 and 0.3.
    """
    total = torch.zeros(())
    for size, weight in ((1, 1.0), (4, 0.5), (16, 0.5), (matte.shape[-1], 0.3)):
        cover = F.avg_pool2d(matte, size)

        def local(x: torch.Tensor, cover: torch.Tensor = cover, size: int = size) -> torch.Tensor:
            return F.avg_pool2d(x * matte, size) / cover.clamp_min(1e-3)

        a, b, y = local(first), local(second), local(clean)
        score = 0.5 * ((a - y).abs() + (b - y).abs()) - 0.5 * (a - b).abs()
        total = total + weight * (score * cover).sum() / (2 * cover.sum())
    return total


def estimator_loss(
    condition: torch.Tensor,
    classes: torch.Tensor,
    clean: torch.Tensor,
    kind: torch.Tensor,
    weights: torch.Tensor,
    importance: torch.Tensor | None = None,
) -> torch.Tensor:
    """Squared error of the expected material, and cross entropy of the material class with weight 0.1.

    Args:
        condition: [B, C, P/2, P/2]; channels 0 and 1 are expected roughness and metallic in [-1, 1].
        classes: [B, classes, P/2, P/2] scores.
        clean: [B, 2, P, P] ground truth in [-1, 1].
        kind: [B, P, P] material class, -1 outside the matte.
        weights: [B, 1, P, P] coverage times the weight of the class.
        importance: [classes] weight of each class; None: all are 1.

    Returns:
        Scalar.
    """
    cover = F.avg_pool2d(weights, 2)
    mean = F.avg_pool2d(clean * weights, 2) / cover.clamp_min(1e-3)
    square = ((condition[:, :2] - mean).square() * cover).sum() / (2 * cover.sum())
    return square + 0.1 * F.cross_entropy(classes, kind[:, ::2, ::2], importance, ignore_index=-1)


def context_loss(
    scores: torch.Tensor, truth: torch.Tensor, kind: torch.Tensor, importance: torch.Tensor
) -> torch.Tensor:
    """As `estimator_loss`, for the context image: every example teaches where materials occur on a subject.

    Args:
        scores: [B, 2 + classes, h, w] expected roughness and metallic in [-1, 1], then the class scores.
        truth: [B, 3, h, w] roughness and metallic in [0, 1], coverage.
        kind: [B, h, w] material class, -1 outside the matte.
        importance: [classes] weight of each class.

    Returns:
        Scalar.
    """
    cover = truth[:, 2:] * importance[kind.clamp_min(0)][:, None]
    square = ((scores[:, :2] - (2 * truth[:, :2] - 1)).square() * cover).sum() / (2 * cover.sum())
    return square + 0.1 * F.cross_entropy(scores[:, 2:], kind, importance, ignore_index=-1)
