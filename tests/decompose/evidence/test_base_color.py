"""Base colour from all views: what it adds to the plate's, and where it stays out of it."""

import numpy as np
import pytest

from tests.decompose.evidence.test_likelihood import random_case
from yesnt.decompose.evidence import reference
from yesnt.decompose.evidence.base_color import base_by_views, spread_over_pixels
from yesnt.decompose.evidence.settings import ROUGHNESS, EvidenceSettings

SETTINGS = EvidenceSettings()
LEVELS = np.array(ROUGHNESS)


def shown(metallic, level=3, points=60):
    """What five cameras see of points of one material, without noise; their responses and true base colours."""
    seen, of = random_case(points)
    of = of._replace(metal_f0=0.3 + 0.7 * of.metal_f0, missing=0.3 * of.missing)  # a lobe that shows its colour
    base = np.random.default_rng(0).uniform(0.2, 0.8, (points, 3))
    slope, offset = reference.linear_form(of, base, level, metallic)
    radiance = (base[:, None] * slope + offset).astype(np.float32)
    sigma = (0.05 * radiance + 1e-3).astype(np.float32)
    materials = np.tile([ROUGHNESS[level], metallic], (points, 1))
    return seen._replace(radiance=radiance, sigma=sigma, valid=np.ones_like(seen.valid)), of, base, materials


def added(seen, of, materials):
    """What the fit over all views changes of the plate's base colour, by its weight."""
    found = base_by_views(seen, of, LEVELS, materials, SETTINGS)
    return found[:, 3:] * (found[:, :3] - inverted(seen, of, materials))


def inverted(seen, of, materials):
    """The base colour that the plate alone gives."""
    alone = np.zeros_like(seen.valid)
    alone[:, 0] = True
    level = int(np.argmin(np.abs(LEVELS - materials[0, 0])))
    return reference.best_base_color(seen._replace(valid=alone), of, SETTINGS, level, materials[0, 1])


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_nothing_is_added_where_the_plate_tells_the_truth(metallic) -> None:
    seen, of, _, materials = shown(metallic)
    assert np.abs(added(seen, of, materials)).max() < 0.01


def test_a_highlight_in_the_plate_of_a_metal_leaves_its_base_colour() -> None:
    seen, of, base, materials = shown(1.0)
    seen.radiance[:, 0] *= 1.25
    before = inverted(seen, of, materials)
    after = before + added(seen, of, materials)
    wrong, left = np.abs(before - base).mean(), np.abs(after - base).mean()
    assert wrong > 0.05
    assert left < 0.3 * wrong


@pytest.mark.parametrize(("metallic", "share"), [(0.0, 0.0), (0.5, 0.0), (0.7, 0.5), (0.9, 1.0), (1.0, 1.0)])
def test_only_metals_leave_the_base_colour_of_the_plate(metallic, share) -> None:
    seen, of, _, materials = shown(metallic)
    seen.radiance[:, 0] *= 1.25
    weight = base_by_views(seen, of, LEVELS, materials, SETTINGS)[:, 3]
    lobe = SETTINGS.lobe_error  # all light is specular where metallic is 1
    assert weight.max() <= share * lobe**2 / (lobe**2 + SETTINGS.sight_error**2) + 1e-6
    assert (weight > 0).all() == (share > 0)


def test_a_matt_surface_keeps_what_the_plate_shows_of_it() -> None:
    """Its texture is finer than what other cameras resolve."""
    seen, of, base, materials = shown(0.0)
    matt = of._replace(dielectric=0 * of.dielectric)
    radiance = (base[:, None] * reference.linear_form(matt, base, 3, 0.0)[0]).astype(np.float32)
    radiance[:, 1:] *= 1.2
    assert not added(seen._replace(radiance=radiance), matt, materials).any(), "no light is specular"


def test_a_roughness_between_two_levels_has_the_responses_between_theirs() -> None:
    seen, of, _, materials = shown(1.0)
    lobes = {name: getattr(of, name) for name in ("diffuse", "dielectric", "metal_f0", "metal_f90", "missing")}
    same = of._replace(**{name: np.repeat(one[:, :, 3:4], len(LEVELS), 2) for name, one in lobes.items()})
    same = same._replace(average=np.full(len(LEVELS), of.average[3], np.float32))
    between = materials.copy()
    between[:, 0] = 0.5 * (ROUGHNESS[3] + ROUGHNESS[4])
    at, beside = (base_by_views(seen, same, LEVELS, one, SETTINGS) for one in (materials, between))
    np.testing.assert_allclose(at, beside, atol=1e-6)
    assert not np.allclose(at, base_by_views(seen, of, LEVELS, between, SETTINGS), atol=1e-3)


@pytest.mark.parametrize("blind", ["two views", "no plate"])
def test_too_few_views_add_nothing(blind) -> None:
    seen, of, _, materials = shown(1.0)
    seen.radiance[:, 0] *= 1.25
    seen.valid[:, 2:] = blind != "two views"
    seen.valid[:, 0] = blind != "no plate"
    assert not added(seen, of, materials).any()


def test_pixels_between_take_the_mean_of_neighbours_of_their_colour() -> None:
    plate = np.full((12, 12, 3), 0.2, np.float32)
    plate[:, 6:] = 0.8
    fitted = np.zeros((12, 12), bool)
    fitted[::2, ::2] = True
    values = np.zeros((12, 12, 4), np.float32)
    values[fitted] = 0.1
    values[:, 6:] *= -1
    found = spread_over_pixels(values, fitted, plate)
    np.testing.assert_allclose(found[:, :6], 0.1, atol=1e-3)
    np.testing.assert_allclose(found[:, 6:], -0.1, atol=1e-3)
    assert not spread_over_pixels(values, np.zeros_like(fitted), plate).any()
