import numpy as np
import pytest

from yesnt.decompose.evidence import fit, reference
from yesnt.decompose.evidence.posterior import estimate, information, log_prior, metallic_shares, moments, posterior
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.settings import (
    DARKEST_METAL,
    HALF_METALS,
    METALLIC,
    ROUGHNESS,
    EvidenceSettings,
    metallic_levels,
    roughness_levels,
)

SETTINGS = EvidenceSettings()


def random_case(points=40, views=5, seed=3):
    """Responses of a plausible size, and what a random base colour would show, with noise."""
    rng = np.random.default_rng(seed)
    shape = points, views, len(ROUGHNESS)
    lobes = [rng.uniform(0, high, (*shape, 3)).astype(np.float32) for high in (1, 0.2, 1, 0.2)]
    missing, average = rng.uniform(0, 0.5, shape), rng.uniform(0.4, 1, len(ROUGHNESS))
    of = Responses(*lobes, missing.astype(np.float32), average.astype(np.float32))
    radiance = rng.uniform(0, 1.2, (points, views, 3)).astype(np.float32)
    sigma = np.sqrt((0.06 * radiance) ** 2 + 0.004**2).astype(np.float32)
    return Observations(radiance, sigma, rng.random((points, views)) < 0.7), of


def test_the_compiled_likelihood_is_the_reference() -> None:
    seen, of = random_case()
    fast, slow = (one.negative_log_likelihood(seen, of, SETTINGS) for one in (fit, reference))
    np.testing.assert_allclose(fast, slow, rtol=2e-5, atol=1e-4)


def test_the_grid_is_the_tables_and_as_many_candidates_as_are_asked_for() -> None:
    assert tuple(roughness_levels(SETTINGS)) == ROUGHNESS
    assert tuple(metallic_levels(SETTINGS)) == METALLIC
    fine = EvidenceSettings(roughness_levels=15, metallic_levels=9)
    np.testing.assert_allclose(roughness_levels(fine)[::2], ROUGHNESS)
    np.testing.assert_allclose(metallic_levels(fine)[::2], METALLIC)
    seen, of = random_case()
    fast, slow = (one.negative_log_likelihood(seen, of, fine) for one in (fit, reference))
    assert fast.shape == (40, len(ROUGHNESS), 9)
    np.testing.assert_allclose(fast, slow, rtol=2e-5, atol=1e-4)
    even = log_prior(np.full((1, 2), 0.5), np.full((1, 2), 9.0), fine)
    assert even.shape == (1, 15, 9)
    assert np.exp(even).sum() == pytest.approx(1, abs=1e-2), "a level stands for its cell"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": 3}, "step 3 must be one of 1, 2, 4"),
        ({"roughness_levels": 1}, r"roughness_levels 1 must be in 2 \.\. 64"),
        ({"radius": 2.5}, "radius 2.5 must be a whole number"),
        ({"passes": 0}, r"passes 0 must be in 1 \.\. 16"),
        ({"temper": 0.0}, "temper 0.0 must be above 0"),
        ({"engine": "cuda"}, "engine cuda must be one of numba, torch"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(changes, message) -> None:
    with pytest.raises(ValueError, match=message):
        EvidenceSettings(**changes)


def turned_case(**kind):
    """A random case with the responses of two turned normals: each lobe changes by some share of itself."""
    seen, of = random_case(**kind)
    rng = np.random.default_rng(8)
    names = "diffuse", "dielectric", "metal_f0", "metal_f90"
    turned = [
        of._replace(**{n: (getattr(of, n) * (1 + 0.3 * rng.normal(size=of.missing.shape))[..., None]).astype(np.float32)
                       for n in names})
        for _ in range(2)
    ]  # fmt: skip
    return seen, of, (turned[0], turned[1])


def test_the_compiled_likelihood_of_a_turned_normal_is_the_reference() -> None:
    seen, of, turned = turned_case()
    fast, slow = (one.negative_log_likelihood(seen, of, SETTINGS, turned) for one in (fit, reference))
    np.testing.assert_allclose(fast, slow, rtol=2e-5, atol=1e-4)
    assert np.abs(fast - fit.negative_log_likelihood(seen, of, SETTINGS)).max() > 1, "the turn is an unknown"


def test_responses_that_do_not_turn_with_the_normal_leave_the_likelihood() -> None:
    seen, of = random_case()
    same = fit.negative_log_likelihood(seen, of, SETTINGS, (of, of))
    np.testing.assert_allclose(same, fit.negative_log_likelihood(seen, of, SETTINGS), rtol=1e-6)


def test_a_turned_normal_is_found_and_the_material_with_it() -> None:
    seen, of, turned = turned_case(views=8)
    base, r, m, turn = np.full((len(seen.valid), 3), 0.4), 5, 4, np.array([0.8, -0.6])
    radiance = reference.expected(of, base, r, METALLIC[m])
    plain = radiance.copy()
    for t, one in zip(turn, turned, strict=True):
        radiance += t * (reference.expected(one, base, r, METALLIC[m]) - plain)
    radiance = np.maximum(radiance, 0).astype(np.float32)
    exact = seen._replace(radiance=radiance, valid=np.ones_like(seen.valid))
    best = [
        (fit.negative_log_likelihood(exact, of, SETTINGS, ways).reshape(len(base), -1).argmin(axis=1)
         == r * len(METALLIC) + m).mean()
        for ways in (turned, None)
    ]  # fmt: skip
    assert best[0] > 0.95
    assert best[1] < best[0] - 0.05, "with the normal taken as it is another material explains the highlights"


def test_what_a_turn_costs() -> None:
    """Half its square, and half the log of how much more precisely the views ask it to be set than it is known."""
    turn, curvature = np.array([[0.0, 0.0], [1.0, 2.0]]), np.stack([np.zeros((2, 2)), 3 * SETTINGS.temper * np.eye(2)])
    np.testing.assert_allclose(reference.turn_cost(turn, curvature, SETTINGS), [0, 2.5 + np.log(4)])


def test_it_is_the_same_to_the_bit_for_any_number_of_threads() -> None:
    import numba

    seen, of = random_case(points=600)
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            found.append(fit.negative_log_likelihood(seen, of, SETTINGS))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)


def test_a_point_that_no_camera_sees_tells_nothing() -> None:
    seen, of = random_case()
    blind = seen._replace(valid=np.zeros_like(seen.valid))
    assert not fit.negative_log_likelihood(blind, of, SETTINGS).any()


def test_the_material_that_was_rendered_has_the_largest_likelihood() -> None:
    seen, of = random_case(views=8)
    base, r, m = np.full((len(seen.valid), 3), 0.4), 5, 4
    slope, offset = reference.linear_form(of, base, r, METALLIC[m])
    exact = seen._replace(radiance=(base[:, None] * slope + offset).astype(np.float32), valid=np.ones_like(seen.valid))
    cost = fit.negative_log_likelihood(exact, of, SETTINGS).reshape(len(base), -1)
    assert (cost.argmin(axis=1) == r * len(METALLIC) + m).mean() > 0.95
    found = reference.best_base_color(exact, of, SETTINGS, r, METALLIC[m])
    np.testing.assert_allclose(found, base, atol=5e-3)


def test_base_colour_stays_within_0_and_1() -> None:
    seen, of = random_case()
    for factor in (0.0, 50.0):  # black, and brighter than any surface can be
        odd = seen._replace(radiance=seen.radiance * np.float32(factor))
        base = reference.best_base_color(odd, of, SETTINGS, 3, 0.0)
        assert base.min() >= 0
        assert base.max() <= 1
        assert np.isfinite(fit.negative_log_likelihood(odd, of, SETTINGS)).all()


def test_one_camera_that_contradicts_seven_hardly_moves_the_base_colour() -> None:
    seen, of = random_case(views=8)
    base, every = np.full((len(seen.valid), 3), 0.4), np.ones_like(seen.valid)
    slope, offset = reference.linear_form(of, base, 5, 0.0)
    radiance = (base[:, None] * slope + offset).astype(np.float32)
    sigma = (0.06 * radiance + 0.004).astype(np.float32)
    spoilt = radiance.copy()
    spoilt[:, 0] *= 2
    found = reference.best_base_color(Observations(spoilt, sigma, every), of, SETTINGS, 5, 0.0)
    once = reference.best_base_color(
        Observations(spoilt, sigma, every), of, EvidenceSettings(freedom=1e9), 5, 0.0
    )  # plain least squares
    assert np.abs(found - base).mean() < 0.5 * np.abs(once - base).mean()


def test_without_evidence_the_posterior_is_the_prior() -> None:
    mean, spread = np.array([[0.5, 0.0], [0.8, 1.0]]), np.full((2, 2), 0.05)
    prior = log_prior(mean, spread, SETTINGS)
    probability = posterior(np.zeros(prior.shape), prior, SETTINGS)
    np.testing.assert_allclose(probability, np.exp(prior) / np.exp(prior).sum((1, 2), keepdims=True), rtol=1e-9)
    found, std = moments(probability, SETTINGS)
    np.testing.assert_allclose(found[:, 0], [0.5, 0.8], atol=0.1, err_msg="the model's roughness stands")
    assert found[0, 1] < 0.25 < found[1, 1], "metallic follows the model"
    assert (std > 0).all()
    assert (std <= 0.5).all()


def test_evidence_makes_the_posterior_narrow_and_half_metals_are_possible() -> None:
    cost = np.full((1, len(ROUGHNESS), len(METALLIC)), 10.0)
    cost[0, 5, 2] = 0.0
    prior = log_prior(np.array([[0.9, 0.0]]), np.full((1, 2), 0.1), SETTINGS)
    found, std = moments(posterior(cost, prior, SETTINGS), SETTINGS)
    np.testing.assert_allclose(found, [[ROUGHNESS[5], 0.5]], atol=0.01)
    cells = 0.5 * (ROUGHNESS[6] - ROUGHNESS[4]), 0.5 * (METALLIC[3] - METALLIC[1])
    least = SETTINGS.stretch * np.hypot(np.array(cells) / np.sqrt(12), [SETTINGS.unknown, 0])
    np.testing.assert_allclose(std[0], least, rtol=0.05, err_msg="a level stands for its cell")


def test_the_prior_on_metallic_is_smooth() -> None:
    shares = metallic_shares(SETTINGS)
    assert shares.sum() == pytest.approx(1)
    assert shares[0] > shares[-1] > shares[1:-1].max()
    assert shares.min() > 0.02


def test_the_share_of_half_metals_is_that_of_the_even_part() -> None:
    assert metallic_shares(SETTINGS)[1:-1].sum() == pytest.approx(HALF_METALS * 0.75, rel=0.1)


def test_darkness_tells_against_a_metal_alone_and_no_more_than_a_bound() -> None:
    level = np.array([0.0, 0.04, 0.3, 0.59, 0.9])
    metal = reference.darkness(1.0, level)
    assert metal[0] == DARKEST_METAL
    assert (np.diff(metal[:4]) <= 0).all()
    assert metal[2] > 0.5
    np.testing.assert_array_equal(metal[3:], 0)
    assert not reference.darkness(0.0, level).any()
    np.testing.assert_allclose(reference.darkness(0.5, level), 0.5 * metal)


def test_a_black_dielectric_is_not_taken_for_a_metal_of_base_colour_0_04() -> None:
    """Both look the same; the darkness of the metal decides."""
    seen, of = random_case(views=6)
    _, offset = reference.linear_form(of, np.zeros((len(seen.valid), 3)), 4, 0.0)
    same = of._replace(metal_f0=25 * of.dielectric, metal_f90=0 * of.dielectric, missing=0 * of.missing)
    black = seen._replace(radiance=offset.astype(np.float32), valid=np.ones_like(seen.valid))
    cost = fit.negative_log_likelihood(black, same, SETTINGS)[:, 4]
    np.testing.assert_allclose((cost[:, -1] - cost[:, 0]) / SETTINGS.temper, DARKEST_METAL, atol=0.5)


def test_many_cameras_that_all_disagree_leave_finite_numbers() -> None:
    """A product of 250 factors of 1e7 has no float64."""
    seen, of = random_case(points=2, views=250)
    far = seen._replace(sigma=np.full_like(seen.sigma, 1e-9), valid=np.ones_like(seen.valid))
    assert np.isfinite(fit.negative_log_likelihood(far, of, SETTINGS)).all()


def test_the_model_stands_where_the_cameras_tell_nothing() -> None:
    """What is usual of surfaces would make each of these a dielectric."""
    model = np.array([[0.5, 0.3], [0.5, 0.6]])
    found, std = estimate(np.zeros((2, len(ROUGHNESS), len(METALLIC))), model, np.full((2, 2), 0.1), SETTINGS)
    np.testing.assert_allclose(found[:, 1], model[:, 1], atol=1e-6)
    np.testing.assert_allclose(std[:, 1], 0.5, err_msg="nothing is known beyond the model's estimate and its error")


def test_the_more_the_cameras_tell_the_less_the_model_counts() -> None:
    model, spread, apart, told = np.array([[0.5, 0.3]]), np.full((1, 2), 0.1), [], []
    for strength in (0.0, 0.02, 0.1, 2.0):
        cost = np.zeros((1, len(ROUGHNESS), len(METALLIC)))
        cost[..., :-1] = strength  # a metal is likelier
        alone, _ = moments(posterior(cost, log_prior(model, spread, SETTINGS), SETTINGS), SETTINGS)
        apart.append(abs(float(estimate(cost, model, spread, SETTINGS)[0][0, 1] - alone[0, 1])))
        told.append(float(information(cost, SETTINGS)[0]))
    assert told[0] == 0
    assert told == sorted(told)
    assert told[-1] > 0.99
    assert apart[0] > 0.1
    assert apart[-1] < 0.01
