import numpy as np
import pytest

from yesnt.capture_stage.procedural_maps import (
    OWN_MAPS,
    SMOOTH_RADIANCE,
    SUN_DIRECTION,
    directions,
    reduce_by_two,
    smooth,
    write_map,
)
from yesnt.io.pictures.image import read_image

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def test_directions_are_the_mapping_of_the_method():
    d = directions(64, 128)
    azimuth = 0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi)
    assert np.allclose(azimuth, (np.arange(128) + 0.5) / 128)
    assert np.allclose(np.arccos(d[..., 2]) / np.pi, ((np.arange(64) + 0.5) / 64)[:, None])
    assert np.abs(d[32, 63:65].mean(axis=0) - (1, 0, 0)).max() < 0.05  # the centre looks along +X
    assert np.abs(d[32, 31:33].mean(axis=0) - (0, 1, 0)).max() < 0.05  # a quarter looks along +Y


def test_sky_has_a_sun_of_ten_thousand_means_where_it_should_be():
    sky = OWN_MAPS["sky"]()
    light = sky @ LUMINANCE
    assert light.max() >= 1e4 * light.mean()
    assert 1 <= (light > 0.25 * light.max()).sum() <= 12
    peak = directions(*light.shape)[np.unravel_index(light.argmax(), light.shape)]
    assert peak @ np.asarray(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION) > np.cos(np.radians(1.5))


def test_capture_light_is_nearly_uniform():
    light = OWN_MAPS["capture"]() @ LUMINANCE
    assert light.max() < 2 * light.min()


def test_maps_are_radiance():
    for radiance in (build() for build in OWN_MAPS.values()):
        assert radiance.dtype == np.float32
        assert radiance.min() >= 0
        assert np.isfinite(radiance).all()


def test_halving_keeps_the_mean():
    radiance = OWN_MAPS["studio"]()
    halved = reduce_by_two(radiance).mean(axis=(0, 1), dtype=np.float64)
    assert np.allclose(halved, radiance.mean(axis=(0, 1), dtype=np.float64), rtol=1e-5)


def test_values_beyond_half_are_written_as_float(tmp_path):
    radiance = np.ones((4, 8, 3), dtype=np.float32)
    radiance[1, 2] = 70000.0
    write_map(tmp_path / "bright.exr", radiance)
    assert read_image(tmp_path / "bright.exr").stack("RGB")[1, 2, 0] == 70000.0


def test_the_smooth_light_is_of_low_order_and_within_its_range():
    radiance = smooth()[..., 0].astype(float)
    assert (radiance.min(), radiance.max()) == pytest.approx(SMOOTH_RADIANCE)
    d = directions(*radiance.shape)
    x, y, z = np.moveaxis(d, -1, 0)
    powers = [x**i * y**j * z**k for i in range(4) for j in range(4) for k in range(2) if i + j + k <= 3]
    terms = np.stack([p.ravel() for p in powers], axis=-1)  # polynomials to degree 3 on the sphere
    left = radiance.ravel() - terms @ np.linalg.lstsq(terms, radiance.ravel(), rcond=None)[0]
    assert np.abs(left).max() < 1e-5
