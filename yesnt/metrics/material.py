"""Errors of estimated materials, and how well the ensemble's standard deviation predicts them; flat arrays [n]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from yesnt.metrics.definitions import Metric, named

Values = NDArray[np.floating]

KEPT = np.linspace(1.0, 0.05, 20)
"""Shares of the pixels that the sparsification curve is sampled at."""


def measure_material(estimate: Values, truth: Values, std: Values | None = None, binary: bool = False) -> list[Metric]:
    """Every number of one material plane over matte pixels [n].

    Args:
        estimate: estimated values.
        truth: true values.
        std: the ensemble's standard deviation; adds the metrics of calibration.
        binary: whether the truth is a class (metal or not); adds the area under the ROC curve.
    """
    error = np.asarray(estimate, float) - np.asarray(truth, float)
    found = [
        named("rmse", root_mean_square(error)),
        named("bias", float(error.mean())),
        named("constant_rmse", float(np.std(truth, dtype=float))),
    ]
    if binary:
        found.append(named("auc", area_under_curve(estimate, np.asarray(truth) > 0.5)))
    if std is not None:
        found += [named("spearman", spearman(std, np.abs(error))), named("ause", ause(error, std))]
    return found


def root_mean_square(error: Values) -> float:
    """Square root of the mean square."""
    return float(np.sqrt(np.mean(np.square(error, dtype=float))))


def area_under_curve(score: Values, positive: NDArray[np.bool_]) -> float:
    """Probability that a positive scores above a negative, ties count half (Mann-Whitney); NaN without either kind."""
    from scipy.stats import rankdata

    n, m = int(positive.sum()), int((~positive).sum())
    if n == 0 or m == 0:
        return math.nan
    return float((rankdata(score)[positive].sum() - n * (n + 1) / 2) / (n * m))


def spearman(a: Values, b: Values) -> float:
    """Rank correlation; NaN if one of them is constant."""
    from scipy.stats import rankdata

    x, y = (rank - rank.mean() for rank in (rankdata(a), rankdata(b)))
    power = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / power if power > 0 else math.nan


def sparsification(error: Values, order_by: Values) -> NDArray[np.float64]:
    """RMSE of the remaining share `KEPT` of pixels when those of largest `order_by` are removed first: [20]."""
    squares = np.square(error, dtype=float)[np.argsort(np.asarray(order_by), kind="stable")]
    counts = np.maximum(1, np.round(KEPT * len(squares)).astype(int))
    curve: NDArray[np.float64] = np.sqrt(np.cumsum(squares)[counts - 1] / counts)
    return curve


def ause(error: Values, std: Values) -> float:
    """Area under the sparsification error: mean gap to the oracle's curve over the RMSE of all; NaN without error."""
    whole = root_mean_square(error)
    if whole == 0:
        return math.nan
    return float(np.mean(sparsification(error, std) - sparsification(error, np.abs(error))) / whole)
