"""Extremes, each with the behaviour that is expected."""

import numpy as np
import pytest

from yesnt.core.errors import JobError
from yesnt.temporal import EnergyParams, solve


def arguments(shape=(3, 5, 6), seed=0, **changes):
    rng = np.random.default_rng(seed)
    frames, height, width = shape
    fields = {
        "observed": rng.random(shape).astype(np.float32),
        "confidence": np.ones(shape, np.float32),
        "flow": np.zeros((frames - 1, height, width, 2), np.float32),
        "validity": np.ones((frames - 1, height, width), np.float32),
        "params": EnergyParams(),
        "matte": np.ones(shape, bool),
    }
    return fields | changes


@pytest.mark.parametrize("frames", [1, 2])
def test_short_sequences_converge(frames):
    stats = solve(**arguments((frames, 12, 13))).stats
    assert stats.converged


def test_an_empty_matte_returns_the_observation():
    fields = arguments(matte=np.zeros((3, 5, 6), bool))
    solution = solve(**fields)
    np.testing.assert_array_equal(solution.value, fields["observed"])
    assert solution.stats.energy == 0
    assert solution.stats.converged


def test_a_frame_without_matte_cuts_the_sequence_in_two():
    matte = np.ones((3, 5, 6), bool)
    matte[1] = False
    fields = arguments(matte=matte)
    whole = solve(**fields, tolerance=1e-7).value
    first = solve(
        **{k: v[:0] if k in ("flow", "validity") else v if k == "params" else v[:1] for k, v in fields.items()},
        tolerance=1e-7,
    ).value
    np.testing.assert_allclose(whole[0], first[0], atol=1e-4)


def test_one_pixel_in_space_and_time_stays_as_observed():
    matte = np.zeros((3, 5, 6), bool)
    matte[1, 2, 3] = True
    fields = arguments(matte=matte)
    np.testing.assert_allclose(solve(**fields).value, fields["observed"], atol=1e-4)


def test_one_pixel_per_frame_is_a_chain():
    matte = np.zeros((3, 5, 6), bool)
    matte[:, 2, 3] = True
    params = EnergyParams(delta=10.0, lambda1=0.0, lambda2=2.0)
    fields = arguments(matte=matte, params=params)
    chain = np.array([[1 + 4, -4, 0], [-4, 1 + 8, -4], [0, -4, 1 + 4]], float)
    expected = np.linalg.solve(chain, fields["observed"][:, 2, 3])
    np.testing.assert_allclose(solve(**fields, tolerance=1e-9).value[:, 2, 3], expected, atol=1e-5)


def test_no_confidence_at_all_gives_a_field_that_costs_nothing():
    fields = arguments(confidence=np.zeros((3, 5, 6), np.float32))
    solution = solve(**fields)
    floor = fields["params"].lambda1 * fields["params"].eps * 90
    assert solution.stats.energy == pytest.approx(floor, rel=1e-3)
    assert np.isfinite(solution.value).all()


def test_without_regularisation_the_observation_is_the_minimum():
    fields = arguments(params=EnergyParams(lambda1=0.0, lambda2=0.0))
    solution = solve(**fields)
    np.testing.assert_array_equal(solution.value, fields["observed"])
    assert solution.stats.gap == 0


def test_lambda1_of_a_million_makes_each_frame_constant():
    fields = arguments(params=EnergyParams(lambda1=1e6, lambda2=0.0, delta=10.0))
    value = solve(**fields).value
    assert np.ptp(value, axis=(1, 2)).max() < 1e-3
    np.testing.assert_allclose(value.mean(axis=(1, 2)), fields["observed"].mean(axis=(1, 2)), atol=1e-3)


def test_lambda2_of_a_million_makes_each_track_constant():
    fields = arguments(params=EnergyParams(lambda1=0.0, lambda2=1e6, delta=10.0))
    value = solve(**fields, tolerance=1e-6).value
    assert np.ptp(value, axis=0).max() < 1e-3
    np.testing.assert_allclose(value[0], fields["observed"].mean(axis=0), atol=1e-3)


def test_eps_of_1e_12_is_total_variation_proper():
    coarse, fine = (solve(**arguments(params=EnergyParams(eps=eps))).stats for eps in (1e-6, 1e-12))
    assert fine.energy == pytest.approx(coarse.energy, rel=1e-3)
    assert np.isfinite(fine.gap)


def test_a_single_member_has_confidence_one_and_is_solved_like_any_other():
    """K = 1: a standard deviation of 0 everywhere, which says nothing; the weight is 1, not undefined."""
    from yesnt.decompose.confidence import confidence

    fields = arguments()
    weight = confidence(np.std(fields["observed"][None], axis=0))
    assert (weight == 1).all()
    solution = solve(**(fields | {"confidence": weight}))
    assert solution.stats.converged
    assert np.abs(solution.value - fields["observed"]).max() > 0


def test_observations_outside_0_1_are_solved_and_not_clipped():
    rng = np.random.default_rng(0)
    fields = arguments(observed=rng.normal(0, 5, (3, 5, 6)).astype(np.float32))
    solution = solve(**fields)
    assert solution.stats.converged
    assert solution.value.max() > 1


@pytest.mark.parametrize("name", ["observed", "confidence", "flow", "validity"])
def test_nan_is_refused_and_the_frame_named(name):
    fields = arguments()
    fields[name] = fields[name].copy()
    fields[name][1, 2, 3] = np.nan
    with pytest.raises(JobError, match=rf"{name} is not finite.*frame 1"):
        solve(**fields)


def test_flow_of_1e5_pixels_leaves_the_frame_and_couples_nothing():
    fields = arguments(flow=np.full((2, 5, 6, 2), 1e5, np.float32))
    alone = solve(**(fields | {"validity": np.zeros((2, 5, 6), np.float32)}))
    np.testing.assert_array_equal(solve(**fields).value, alone.value)


@pytest.mark.parametrize(
    ("name", "shape"),
    [("flow", (3, 5, 6, 2)), ("validity", (2, 5, 5)), ("confidence", (2, 5, 6)), ("matte", (3, 6, 5))],
)
def test_wrong_shapes_are_named(name, shape):
    with pytest.raises(JobError, match=f"{name} has the wrong shape"):
        solve(**(arguments() | {name: np.ones(shape, np.float32)}))


def test_negative_confidence_and_unknown_method_are_refused():
    with pytest.raises(JobError, match="confidence is negative"):
        solve(**arguments(confidence=np.full((3, 5, 6), -0.1, np.float32)))
    with pytest.raises(JobError, match="unknown solver"):
        solve(**arguments(), method="magic")


@pytest.mark.parametrize("change", [{"delta": 0}, {"eps": 0.0}, {"lambda1": -1}, {"lambda2": float("nan")}])
def test_parameters_out_of_range_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        EnergyParams(**change)


def test_4k_frames_with_a_small_matte_cost_what_the_matte_costs():
    shape = (2, 2160, 3840)
    matte = np.zeros(shape, bool)
    matte[:, 1000:1040, 3780:3840] = True
    rng = np.random.default_rng(0)
    observed = rng.random(shape, dtype=np.float32)
    flow = np.full((1, *shape[1:], 2), (0.5, 0.25), np.float32)
    ones = np.ones(shape, np.float32)
    solution = solve(observed, ones, flow, ones[:1], EnergyParams(), matte)
    assert solution.stats.pixels == 2 * 40 * 60
    assert solution.stats.converged
