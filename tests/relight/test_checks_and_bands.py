"""Maps of a wrong shape, rows of pixels in bands, and points that lie just below the proxy."""

from types import SimpleNamespace

import numpy as np
import pytest

from yesnt.core.errors import JobError
from yesnt.relight import EnvMap
from yesnt.relight.occlusion import _seen_triangle
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.sparse import bands


@pytest.mark.parametrize("shape", [(4, 8), (4, 8, 4), (1, 4, 8, 3), (0, 8, 3)])
def test_a_map_of_another_shape_is_refused(shape):
    with pytest.raises(JobError, match="not a colour image"):
        EnvMap.from_array(np.ones(shape))


def test_bands_hold_about_as_many_pixels_as_asked_for():
    pixels = SimpleNamespace(index=np.arange(40 * 10), shape=(40, 10))
    assert [band.part for band in bands(pixels, 400)] == [slice(0, 400)]
    parts = [band.part for band in bands(pixels, 100)]
    assert len(parts) > 1
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == 400
    assert all(part.stop - part.start <= 100 for part in parts)


def test_a_point_just_below_the_proxy_is_lifted_onto_it_and_a_deep_one_is_not():
    corners = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], np.float32)
    floor = ProxyScene.from_arrays(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    eye = np.array([0, 0, 3], np.float32)
    depth = np.array([0.01, 0.02, 0.1, -0.01])
    target = np.array([[1.0, 0.3, 0], [-2, 0.5, 0], [1, 2, 0], [0.5, 2, 0]])
    ray = (target - eye) / np.linalg.norm(target - eye, axis=1, keepdims=True)
    below = (target + ray * depth[:, None]).astype(np.float32)
    pixels = SimpleNamespace(position=below, view=-ray.astype(np.float32))
    shown, gap = _seen_triangle(floor, eye, pixels)
    assert np.all(shown >= 0)
    np.testing.assert_allclose(gap, [0.01, 0.02, 0, 0], atol=2e-6)
