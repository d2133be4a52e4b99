"""Interpolation between pixels that agree."""

from __future__ import annotations

import numpy as np

from tests.scene.set_scenes import view
from yesnt.scene.interpolate import interpolated


def test_a_smooth_function_is_evaluated_at_few_pixels():
    pixels, asked = view().pixels, []

    def evaluate(some):
        asked.append(len(some))
        row, column = np.divmod(pixels.index[some], pixels.shape[1])
        return np.stack([row, 2 * column - row], axis=-1).astype(np.float32)

    found = interpolated(pixels, evaluate, 100.0, 4)
    np.testing.assert_allclose(found, evaluate(np.arange(len(pixels.index))), atol=1e-4)
    assert sum(asked[:-1]) < len(pixels.index) / 2


def test_a_step_is_evaluated_where_it_is():
    pixels = view().pixels
    edge = (pixels.position[:, 0] > 0.3).astype(np.float32)[:, None]
    found = interpolated(pixels, lambda some: edge[some], 0.1, 8)
    np.testing.assert_array_equal(found, edge)


def test_spacing_one_evaluates_every_pixel():
    pixels, asked = view().pixels, []

    def evaluate(some):
        asked.extend(some.tolist())
        return np.zeros((len(some), 1), np.float32)

    interpolated(pixels, evaluate, 1.0, 1)
    assert sorted(asked) == list(range(len(pixels.index)))
