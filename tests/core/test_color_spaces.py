"""Chromaticities: matrices to Rec.709, names of spaces, and values that span no space."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from yesnt.core.color_spaces import PRIMARIES, chromaticities_of, matrix_to_rec709, same_space, space_of_chromaticities

MATRICES = {name: matrix_to_rec709(known) for name, known in PRIMARIES.items()}


@pytest.mark.parametrize("name", PRIMARIES)
def test_white_stays_white(name: str) -> None:
    np.testing.assert_allclose(MATRICES[name] @ np.ones(3), 1, atol=1e-12)


def test_rec709_is_itself_and_acescg_is_as_the_academy_has_it() -> None:
    np.testing.assert_allclose(MATRICES["lin_rec709_scene"], np.eye(3), atol=1e-12)
    academy = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    np.testing.assert_allclose(MATRICES["lin_ap1_scene"], academy, atol=1e-5)  # ACES technical note TN-0005


@pytest.mark.parametrize("name", PRIMARIES)
def test_a_space_is_known_by_its_chromaticities_with_its_own_white_or_adapted(name: str) -> None:
    assert space_of_chromaticities(PRIMARIES[name]) == name
    assert space_of_chromaticities(np.float32(PRIMARIES[name])) == name
    assert space_of_chromaticities(chromaticities_of(MATRICES[name])) == name


def test_no_two_spaces_are_taken_for_each_other() -> None:
    assert not any(same_space(a, b) for a, b in itertools.combinations(MATRICES.values(), 2))
    assert space_of_chromaticities((0.6, 0.35, 0.3, 0.55, 0.2, 0.1, 0.3127, 0.329)) is None


@pytest.mark.parametrize("values", [(0.0,) * 8, (np.nan,) * 8, (0.3,) * 8, (0.3,) * 6])
def test_nonsense_is_refused(values: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"chromaticities|one line"):
        space_of_chromaticities(values)
