"""No garment that is measured is trained on: places, colours and roughness of the sets' clothes against drawn ones."""

import numpy as np
import pytest

from yesnt.capture_stage.subjects import SUBJECTS, Human
from yesnt.training import garments

DRAWN = 300
BODY = {"skin", "lips", "eyes", "hair"}
"""Layers that every body has at the same place."""


SHARED_PLACES = {"walk: collar", "courtier: caps"}
"""Garments whose place is also drawn in training, in other paint: the measure of those pixels is kinder than it is
elsewhere. Nothing may be added here."""


def measured():
    return [
        (name, layer)
        for name, subject in SUBJECTS.items()
        if isinstance(subject, Human)
        for layer in subject.material_layers()
        if layer.name not in BODY
    ]


@pytest.fixture(scope="module")
def drawn():
    costumes = [garments.draw_garments(np.random.default_rng(seed)).frozen_layers() for seed in range(DRAWN)]
    return [layer for costume in costumes for layer in costume if layer.name not in BODY]


def bounds(layer):
    return {(place.field, place.low, place.high) for place in layer.where}


def test_no_garment_of_the_sets_is_drawn(drawn):
    """Equal in place: every bound of the one is a bound of the other."""
    places = [bounds(layer) for layer in drawn]
    same = {f"{subject}: {layer.name}" for subject, layer in measured() if bounds(layer) in places}
    assert same <= SHARED_PLACES


def test_no_paint_of_the_sets_is_drawn(drawn):
    """Equal in paint: both colours and the middle of the roughness to 0.01, and metal alike."""
    paints = np.array([[*np.ravel(layer.colors), np.mean(layer.roughness), layer.metallic] for layer in drawn])
    for subject, layer in measured():
        mine = np.array([*np.ravel(layer.colors), np.mean(layer.roughness), layer.metallic])
        assert np.abs(paints - mine).max(axis=1).min() > 0.01, f"{subject}: {layer.name}"
