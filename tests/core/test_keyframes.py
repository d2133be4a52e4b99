"""Values by frame."""

from __future__ import annotations

import pytest

from yesnt.core.keyframes import numbers_at
from yesnt.core.shot import LightInput

TURN = {1011: (350.0, -10.0, 4.0), 1001: (0.0, 10.0, 4.0)}


@pytest.mark.parametrize(
    ("frame", "angles"),
    [
        (1, (0, 10, 4)), (1001, (0, 10, 4)), (1006, (175, 0, 4)), (1010, (315, -8, 4)), (1011, (350, -10, 4)),
        (2000, (350, -10, 4)),
    ],
)  # fmt: skip
def test_each_angle_is_linear_between_keys_and_constant_outside(frame: int, angles: tuple[float, ...]) -> None:
    assert numbers_at(TURN, frame) == pytest.approx(angles)


def test_a_light_of_a_frame_is_the_light_with_fixed_values() -> None:
    light = LightInput(path="l.exr", rotation={1001: (0, 0, 0), 1003: (350, 0, 0)}, exposure={1001: 1.0, 1002: 2.0})
    assert light.at(1002) == LightInput(path="l.exr", rotation=(175, 0, 0), exposure=2.0)
    fixed = LightInput(path="l.exr", exposure=1.0)
    assert fixed.at(1002) == fixed
