"""A Gaussian field: what it accepts, refuses and says of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gaussians.scenes import random_field
from yesnt.core.errors import JobError

FIELD = random_field(5, degree=1)


def test_covariances_have_the_axes_and_variances_of_the_field() -> None:
    for covariance, axes, log_scales in zip(FIELD.covariances, FIELD.axes, FIELD.log_scales, strict=True):
        along = axes.T @ covariance @ axes
        assert np.allclose(along, np.diag(np.exp(2 * log_scales.astype(float))), atol=1e-9)


def test_a_smoothing_filter_widens_every_axis_and_keeps_opacity_times_volume() -> None:
    filtered = replace(FIELD, filter_3d=np.full(5, 0.03, np.float32))
    own = 1 / (1 + np.exp(-FIELD.opacity_logits.astype(float)))
    assert np.allclose(filtered.variances, FIELD.variances + 0.03**2, rtol=1e-5)
    volume = np.sqrt(np.prod(filtered.variances, 1)), np.sqrt(np.prod(FIELD.variances, 1))
    assert np.allclose(filtered.opacities * volume[0], own * volume[1], rtol=1e-6)


def test_the_digest_depends_on_every_array_and_on_the_colour_space() -> None:
    changed = [replace(FIELD, **{name: -getattr(FIELD, name)}) for name in ("positions", "rotations", "harmonics")]
    changed += [replace(FIELD, color_space="linear"), replace(FIELD, filter_3d=np.zeros(5, np.float32))]
    assert len({FIELD.digest, *(field.digest for field in changed)}) == 6
    assert replace(FIELD).digest == FIELD.digest


def test_arrays_of_a_field_cannot_be_written() -> None:
    with pytest.raises(ValueError, match="read-only"):
        FIELD.positions[0] = 0


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("rotations", np.full((5, 4), 0.9), "rotations, first Gaussian 0: .* Expected: a quaternion of length 1"),
        ("positions", np.full((5, 3), np.nan), "5 of 5 Gaussians .* positions, .* Expected: a finite number"),
        ("log_scales", np.full((5, 3), 31.0), "log_scales, .* Expected: between -30 and 30"),
        ("filter_3d", np.full(5, -1.0), "filter_3d, .* Expected: 0 or more"),
        ("opacity_logits", np.zeros((5, 1)), r"the shape \[5, 1\]. Where: opacity_logits. Expected: \[5\]"),
        ("harmonics", np.zeros((5, 5, 3)), r"Where: harmonics. Expected: \[5, 1, 4, 9 or 16, 3\]"),
        ("color_space", "acescg", "no colour space"),
    ],
)
def test_what_no_field_holds_is_refused(name: str, value: object, message: str) -> None:
    with pytest.raises(JobError, match=message):
        replace(FIELD, **{name: value})
