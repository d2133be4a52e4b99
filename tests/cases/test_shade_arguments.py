"""`shade` refuses arrays that cannot be what its documentation asks for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.cases.shots import POSE, sky_with_sun, sphere
from yesnt.relight import Camera, EnvMap, GBuffer, shade

HEIGHT, WIDTH = 24, 32
SPHERE = sphere(WIDTH, HEIGHT)
RED = np.zeros((HEIGHT, WIDTH, 3))
RED[..., 0] = 0.8


def shaded(base: np.ndarray = RED, roughness: np.ndarray | None = None, scale: int = 1) -> np.ndarray:
    """Mean radiance of the sphere, seen by a camera of `scale` times the arrays' size."""
    pose = {0: np.array(POSE, float).reshape(4, 4)}
    width, height = WIDTH * scale, HEIGHT * scale
    camera = Camera(width, height, 1.6 * width, 1.6 * width, width / 2, height / 2, pose)
    roughness = np.full((HEIGHT, WIDTH), 0.5) if roughness is None else roughness
    arrays = base, roughness, np.zeros((HEIGHT, WIDTH)), SPHERE.normal, SPHERE.z, SPHERE.matte.astype(float)
    radiance = shade(GBuffer(*arrays), EnvMap.from_array(sky_with_sun()), camera).radiance
    return np.asarray(radiance)[SPHERE.hit].mean(0)


WRONG: dict[str, Callable[[], object]] = {
    "channels first": lambda: shaded(RED.transpose(2, 0, 1)),
    "a camera of twice the size": lambda: shaded(scale=2),
    "roughness one column wider": lambda: shaded(roughness=np.tile(np.linspace(0, 1, WIDTH + 1), (HEIGHT, 1))),
    "8-bit base colour": lambda: shaded(np.full((HEIGHT, WIDTH, 3), 128, np.uint8)),
}


def test_arrays_of_the_right_shape_are_shaded() -> None:
    red, green, blue = shaded()
    assert red > 2 * green > 0
    assert green == pytest.approx(blue)


@pytest.mark.parametrize("mistake", WRONG)
def test_wrong_arrays_are_refused(mistake: str) -> None:
    with pytest.raises((ValueError, TypeError), match=r"shape|dtype"):
        WRONG[mistake]()
