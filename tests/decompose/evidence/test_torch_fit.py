"""The likelihood on a torch device against the compiled one."""

from dataclasses import replace

import numpy as np
import pytest

from tests.decompose.evidence.scenes import around, inputs, smooth_light
from tests.decompose.evidence.test_likelihood import random_case, turned_case
from yesnt.decompose.evidence import torch_fit
from yesnt.decompose.evidence.fit import negative_log_likelihood
from yesnt.decompose.evidence.frame import measure_frame
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.relight import RelightSettings


@pytest.mark.parametrize("knobs", [{}, {"metallic_levels": 3, "freedom": 20.0, "steps": 2}])
def test_it_is_the_compiled_likelihood(knobs) -> None:
    seen, of = random_case(points=60)
    seen.valid[7], seen.radiance[8], seen.radiance[9, 0] = False, 0.0, 1e6
    settings = EvidenceSettings(**knobs)
    expected = negative_log_likelihood(seen, of, settings)
    found = torch_fit.negative_log_likelihood_torch(seen, of, settings, device="cpu")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)
    assert not found[7].any(), "no camera sees it"


def test_it_is_the_compiled_likelihood_of_a_turned_normal() -> None:
    seen, of, turned = turned_case(points=60)
    settings = EvidenceSettings()
    expected = negative_log_likelihood(seen, of, settings, turned)
    found = torch_fit.negative_log_likelihood_torch(seen, of, settings, turned, device="cpu")
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_a_frame_is_measured_alike_by_both_engines() -> None:
    given, _ = inputs(around(2), smooth_light(), 10)
    relight = RelightSettings(capture_texels=64, capture_clusters=8)
    few = EvidenceSettings(roughness_levels=2, step=4, passes=1)
    found = [measure_frame(given, relight, replace(few, engine=engine)) for engine in ("numba", "torch")]
    for name in ("mean", "std", "views"):
        np.testing.assert_allclose(*(getattr(one, name) for one in found), atol=1e-3)
    assert not np.array_equal(found[0].mean, found[1].mean), "rounding tells that another engine computed"


def test_memory_is_bounded_by_tiles_that_change_nothing(monkeypatch) -> None:
    seen, of = random_case(points=60)
    whole = torch_fit.negative_log_likelihood_torch(seen, of, EvidenceSettings(), device="cpu")
    sizes = []
    make = torch_fit._Tile.of

    def counted(part, *more):
        sizes.append(part.radiance.size * 5)
        return make(part, *more)

    monkeypatch.setattr(torch_fit, "_VALUES", 800)
    monkeypatch.setattr(torch_fit._Tile, "of", counted)
    parts = torch_fit.negative_log_likelihood_torch(seen, of, EvidenceSettings(), device="cpu")
    np.testing.assert_array_equal(parts, whole)
    assert max(sizes) <= 800
