import numpy as np
import pytest

from tests.relight.scenes import sky, sphere
from yesnt.core.errors import JobError
from yesnt.relight import EnvMap, prepare_light, shade
from yesnt.relight.envmap import cell_moments, direction_to_uv, rotation_matrix, row_solid_angles, uv_to_direction

AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [0.6, 0, 0.8]])


def colour(direction):
    """A radiance that tells all directions apart."""
    return 1 + 0.5 * np.asarray(direction)


def test_blender_mapping_of_named_directions():
    u, v = direction_to_uv(np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]))
    assert np.allclose(u[:2], [0.5, 0.25])
    assert np.allclose(v, [0.5, 0.5, 0.0])
    u, v = np.meshgrid((np.arange(8) + 0.5) / 8, (np.arange(4) + 0.5) / 4)
    back = direction_to_uv(uv_to_direction(u, v))
    assert np.allclose(back[0], u)
    assert np.allclose(back[1], v)


@pytest.mark.parametrize("convention", ["blender", "opengl", "mitsuba"])
def test_chrome_sphere_reflects_the_same_world_in_every_convention(convention):
    height, width = 128, 256
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    if convention == "blender":
        world = uv_to_direction(u, v)
    else:  # the renderer's own formula, Y up, then (x, y, z) -> (x, -z, y)
        turn = 2 * np.pi * (u - 0.5)
        ahead = -1 if convention == "opengl" else 1
        x = np.sin(turn) if convention == "opengl" else -np.sin(turn)
        local = np.stack([x * np.sin(np.pi * v), np.cos(np.pi * v), ahead * np.cos(turn) * np.sin(np.pi * v)], -1)
        world = np.stack([local[..., 0], -local[..., 2], local[..., 1]], -1)
    env = EnvMap.from_array(colour(world), convention)
    view = np.array([0.0, -1.0, 0.0])  # towards the camera
    normal = AXES[[2, 0, 3, 4]] + view
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mirror = 2 * (normal @ view)[:, None] * normal - view
    assert np.allclose(env.lookup(mirror), colour(mirror), atol=0.02)


@pytest.mark.parametrize("size", [(1, 2), (16, 32), (50, 90), (300, 600)])
@pytest.mark.parametrize("grid", [(1, 2), (16, 32), (32, 64), (37, 61)])
def test_cells_keep_energy_and_solid_angle(size, grid):
    env = EnvMap.from_array(np.random.default_rng(0).gamma(0.3, 1, (*size, 3)))
    cells = cell_moments(env, grid)
    whole = (env.radiance.astype(np.float64) * row_solid_angles(*size)[:, None, None]).sum((0, 1))
    assert np.allclose(cells[..., :3].sum((0, 1)), whole, rtol=1e-6)
    assert np.isclose(cells[..., 6].sum(), 4 * np.pi, rtol=1e-9)


@pytest.mark.parametrize(("texels", "clusters"), [(1, 1), (64, 8), (500, 500), (10**6, 16)])
def test_prepared_light_keeps_energy(texels, clusters):
    env = sky(24).turned((30, 40, 50), 1.0)
    light = prepare_light(env, texels, clusters)
    whole = 2 * (env.radiance.astype(np.float64) * row_solid_angles(24, 48)[:, None, None]).sum((0, 1))
    for level in range(len(light.texels.start)):
        assert np.allclose(light.texels.level(level)[3:6].sum(1, dtype=np.float64), whole, rtol=1e-6)
        assert np.isclose(light.texels.level(level)[6].sum(dtype=np.float64), 4 * np.pi, rtol=1e-6)
    assert np.allclose(light.clusters.energy.sum(1, dtype=np.float64), whole, rtol=1e-6)
    assert np.allclose(np.linalg.norm(light.texels.direction, axis=0), 1, atol=1e-5)
    assert len(light.clusters) <= max(clusters, 1)


def test_a_map_that_fits_is_summed_texel_by_texel():
    light = prepare_light(sky(8), 128, 16)
    seen = light.texels.direction[:, light.texels.solid_angle > 0]
    assert seen.shape == (3, 128)
    expected = uv_to_direction((np.arange(16)[None] + 0.5) / 16, (np.arange(8)[:, None] + 0.5) / 8).reshape(-1, 3)
    found = seen.T[np.lexsort(seen.round(4))]
    assert np.allclose(found, expected[np.lexsort(expected.T.round(4))], atol=1e-4)


def test_the_sun_has_texels_of_its_own():
    radiance = np.full((128, 256, 3), 0.1, np.float32)
    radiance[30, 60] = 1e5
    light = prepare_light(EnvMap.from_array(radiance), 512, 64)
    brightest = light.texels.energy[0].argmax()
    assert light.texels.solid_angle[brightest] < 1e-2
    sun = uv_to_direction(60.5 / 256, 30.5 / 128)
    assert light.texels.direction[:, brightest] @ sun > 0.99999


def test_rotation_of_the_map_turns_what_is_seen():
    env = sky(32)
    turned = env.turned((20, 30, 40))
    matrix = rotation_matrix((20, 30, 40))
    assert np.allclose(matrix @ matrix.T, np.eye(3))
    away = AXES[[0, 1, 3, 4, 6]]  # at a pole every column is as right as the next
    assert np.allclose(turned.lookup(away @ matrix.T), env.lookup(away), atol=1e-4)
    assert np.allclose(env.turned((90, 0, 0)).lookup([0, 1, 0]), env.lookup([1, 0, 0]), atol=1e-4)  # yaw is about +Z


def test_exposure_is_in_stops():
    assert np.allclose(sky().turned((0, 0, 0), 2).lookup(AXES), 4 * sky().lookup(AXES))


def test_bad_radiance_is_cleaned_and_bad_maps_are_refused():
    radiance = np.ones((4, 8, 3))
    radiance[0, 0], radiance[1, 1], radiance[2, 2] = np.nan, -5, np.inf
    env = EnvMap.from_array(radiance)
    assert np.isfinite(env.radiance).all()
    assert env.radiance.min() == 0
    assert env.radiance[2, 2, 0] == 1  # the largest finite one
    with pytest.raises(JobError, match="colour image"):
        EnvMap.from_array(np.ones((4, 8)))
    with pytest.raises(JobError, match="convention"):
        EnvMap.from_array(np.ones((4, 8, 3)), "sideways")


@pytest.mark.slow
def test_an_8k_map():
    radiance = np.full((4096, 8192, 3), 0.5, dtype=np.float32)
    light = prepare_light(EnvMap.from_array(radiance), 2048, 256)
    assert np.allclose(light.clusters.energy.sum(1), 2 * np.pi, rtol=1e-5)
    gbuffer, cam = sphere((4, 4), base=(1, 1, 1))
    shading = shade(gbuffer, EnvMap.from_array(radiance), cam, "standard", shadows=False)
    assert np.allclose(shading.radiance[gbuffer.opacity > 0], 0.5, rtol=0.02)
