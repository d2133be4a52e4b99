"""What the set sees of the subject: colours of sides that the delivered camera does not see, and their bounces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.relight.scenes import sky
from tests.scene.set_scenes import GROUND, box, material
from yesnt.relight.lights import prepare_light
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.surroundings import Surroundings
from yesnt.scene.set_frame import inner_pixels


def test_edge_pixels_colour_nothing_unless_there_are_only_edges() -> None:
    shown, opacity = np.array([3, 4, -1, 5], np.int32), np.array([1, 0.3, 1, 0.95], np.float32)
    np.testing.assert_array_equal(inner_pixels(shown, opacity), [3, -1, -1, 5])
    np.testing.assert_array_equal(inner_pixels(shown, opacity * 0.5), shown)


def test_a_wide_open_ground_does_not_hide_what_a_bounce_is_worth_to_the_subject() -> None:
    light = prepare_light(sky(), 128, 64)
    raised = box((-0.05, -0.05, 0.01), (0.05, 0.05, 0.1))
    own, ground = len(raised.faces), ProxyScene.from_arrays(*GROUND.mesh())
    scene = Surroundings(ground, material()).around(raised)
    albedo = np.full((len(scene.faces), 3), 0.5, np.float32)

    def received(first: int | None) -> NDArray[np.float32]:
        return scene.gather(light.coarse, albedo, 2, 0.002, 0.03, first=first)[0][:own]

    once, twice = (scene.gather(light.coarse, albedo, n, 0.002)[0][:own] for n in (1, 2))
    assert np.abs(twice - once).max() > 0, "the ground sends light up"
    np.testing.assert_array_equal(received(None), once)
    np.testing.assert_array_equal(received(own), twice)
