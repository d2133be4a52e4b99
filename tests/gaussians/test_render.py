"""The rasteriser: laws on single Gaussians, the NumPy reference, gradients, threads."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from tests.gaussians.scenes import camera_at, one_gaussian, random_field, view_at
from yesnt.core.camera import Camera
from yesnt.core.distortion import Distortion
from yesnt.core.errors import JobError
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.harmonics import basis
from yesnt.gaussians.opacity import ellipsoids, opacity_reference
from yesnt.gaussians.rasterise import arrays_of, backpropagate, pinhole_of, rasterise
from yesnt.gaussians.records import SURFACE, RenderSettings, View
from yesnt.gaussians.reference import render_reference
from yesnt.gaussians.render import render

VIEW = view_at((2, -1, 0.7), (45, 37), 40.0)
IMAGES = ("color", "alpha", "normal", "median_z", "mean_z", "surface_z", "distortion")


def pixel(field: GaussianField, eye: tuple[float, float, float] = (2, 0, 0)):
    """The middle pixel of a small picture from `eye`, in colour, alpha, normal and both depths."""
    seen = render(field, camera_at(eye, (9, 9), 60.0))
    return seen.color[4, 4], seen.alpha[4, 4], seen.normal[4, 4], seen.median_z[4, 4], seen.mean_z[4, 4]


def test_one_gaussian_is_its_opacity_its_colour_and_its_depth() -> None:
    color, alpha, normal, median_z, mean_z = pixel(one_gaussian((0.1, 0.1, 0.1), 0.8))
    assert np.allclose(color, 0.4, atol=1e-5)
    assert np.allclose([alpha, median_z, mean_z], [0.8, 2, 2], rtol=1e-5)
    assert np.allclose(normal, [1, 0, 0], atol=1e-5)


def test_the_response_off_the_axis_is_that_of_the_distance_to_the_ray() -> None:
    field, view = one_gaussian((0.1, 0.1, 0.1), 0.8), view_at((2, 0, 0), (15, 15), 60.0)
    rays = view.rays()
    sine2 = 1 - 1 / (rays * rays).sum(-1)  # squared distance of a ray to the centre, over 2 m squared
    expected = 0.8 * np.exp(-0.5 * 4 * sine2 / 0.1**2)
    assert np.allclose(render(field, view).alpha, np.where(expected < 1 / 255, 0, expected), atol=2e-5)


def test_of_two_gaussians_the_nearer_one_covers_the_farther_one_in_either_order() -> None:
    front, back = one_gaussian((0.1,) * 3, 0.6, (0.5, 0, 0)), one_gaussian((0.1,) * 3, 0.9, (-0.5, 0, 0))
    for first, second in ((front, back), (back, front)):
        parts = {n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in ("positions", "log_scales")}
        parts |= {n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in ("rotations", "opacity_logits")}
        both = GaussianField(**parts, harmonics=np.concatenate([first.harmonics, second.harmonics]))
        _, alpha, _, median_z, mean_z = pixel(both)
        assert np.allclose(alpha, 0.6 + 0.4 * 0.9, rtol=1e-4)
        assert np.allclose(median_z, 1.5, rtol=1e-4)
        assert np.allclose(mean_z, (0.6 * 1.5 + 0.36 * 2.5) / 0.96, rtol=1e-4)


def test_the_surface_lies_where_the_opacity_along_the_ray_reaches_the_level() -> None:
    """One Gaussian of opacity o reaches the level a at s sqrt(2 ln(o / a)) before its centre."""
    for level, opacity, size in ((0.3, 0.8, 0.1), (0.5, 0.9, 0.02), (0.79, 0.8, 0.2)):
        seen = render(
            one_gaussian((size,) * 3, opacity), camera_at((2, 0, 0), (9, 9), 60.0), settings=RenderSettings(level=level)
        )
        assert seen.surface_z[4, 4] == pytest.approx(2 - size * np.sqrt(2 * np.log(opacity / level)), abs=1e-4)
    never = render(one_gaussian((0.1,) * 3, 0.2), camera_at((2, 0, 0), (9, 9), 60.0))
    assert never.alpha.max() > 0.19
    assert never.surface_z.max() == 0


def test_the_surface_of_a_view_is_the_level_set_of_the_mesh() -> None:
    """At points of the depth image the opacity that the mesh is made of, seen from this camera, is the level."""
    field = random_field(60, seed=4)
    seen = render(field, VIEW)
    v, u = np.nonzero(seen.surface_z)
    points = VIEW.position + seen.surface_z[v, u, None].astype(float) * (VIEW.rays()[v, u] @ VIEW.rotation)
    found = opacity_reference(points, ellipsoids(field), VIEW.position)
    assert len(found) > 200
    assert np.quantile(np.abs(found - SURFACE), 0.98) < 5e-3


def test_a_flat_disc_shows_its_own_normal_from_every_side() -> None:
    disc = one_gaussian((0.2, 0.2, 0.002), 0.9)
    for eye in ((1.2, 0.3, 1.5), (-0.7, 1.0, -1.5)):
        _, _, normal, median_z, _ = pixel(disc, eye)
        assert np.allclose(normal, [0, 0, np.sign(eye[2])], atol=1e-2)
        assert np.allclose(median_z, np.linalg.norm(eye), rtol=1e-3)


def test_what_is_behind_the_camera_or_almost_transparent_is_not_seen() -> None:
    for field in (one_gaussian((0.1,) * 3, 0.8, (3, 0, 0)), one_gaussian((0.1,) * 3, 1 / 256)):
        assert render(field, VIEW).alpha.max() == 0


@pytest.mark.parametrize("scale", [1e-7, 1e-3, 10.0, 1e4])
def test_huge_and_tiny_gaussians_and_a_camera_inside_one_are_finite_and_like_the_reference(scale: float) -> None:
    field = one_gaussian((scale, 0.3 * scale, scale), 0.9, (0.02, 0.01, 0))
    fast, slow = render(field, VIEW), render_reference(field, VIEW)
    for name in IMAGES:
        assert np.isfinite(getattr(fast, name)).all()
    assert np.allclose(fast.alpha, slow.alpha, atol=2e-4)
    assert (fast.alpha.max() > 0.8) == (scale > 1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_fast_images_are_those_of_the_reference(degree: int) -> None:
    field = replace(random_field(60, degree, seed=degree), filter_3d=np.full(60, 0.01 * degree, np.float32))
    fast, slow = render(field, VIEW), render_reference(field, VIEW)
    for name in IMAGES:
        # 1 / 255 is a step: where the float32 response is on its other side, a pixel differs by that much.
        difference = np.abs(getattr(fast, name) - getattr(slow, name))
        assert np.quantile(difference, 0.995) < 1e-4, name
        assert difference[slow.alpha > 0.1].max() < 0.02, name
    assert slow.alpha.max() > 0.8


def test_thin_discs_at_grazing_angles_are_like_the_reference() -> None:
    field = random_field(60, seed=5, thin=0.003)
    fast, slow = render(field, VIEW), render_reference(field, VIEW)
    assert np.quantile(np.abs(fast.alpha - slow.alpha), 0.99) < 1e-3
    assert np.abs(fast.color - slow.color).mean() < 1e-4


def test_alpha_is_within_bounds_and_no_colour_exceeds_the_brightest_gaussian() -> None:
    seen = render(random_field(400, 0, seed=2), VIEW)
    assert seen.alpha.min() >= 0
    assert seen.alpha.max() <= 1
    brightest = 0.5 + 0.2820948 * random_field(400, 0, seed=2).harmonics.max()
    assert (seen.color <= brightest * seen.alpha[..., None] + 1e-5).all()


def test_turning_world_and_camera_together_changes_nothing() -> None:
    field, turn = random_field(40, 0, seed=7), np.array([np.cos(0.4), 0, 0, np.sin(0.4)])
    from yesnt.gaussians.field import rotation_matrices

    matrix = rotation_matrices(turn)
    w, x, y, z = turn
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    turned = replace(field, positions=field.positions @ matrix.T, rotations=field.rotations @ left.T)
    view = replace(VIEW, rotation=VIEW.rotation @ matrix.T, position=matrix @ VIEW.position)
    before, after = render(field, VIEW), render(turned, view)
    assert np.allclose(before.color, after.color, atol=2e-5)
    assert np.allclose(before.normal @ matrix.T, after.normal, atol=2e-4)


def test_a_window_of_a_view_is_that_part_of_the_picture() -> None:
    field = random_field(60, seed=4)
    whole, part = render(field, VIEW), render(field, VIEW.window(11, 5, 20, 18))
    assert np.allclose(whole.color[5:23, 11:31], part.color, atol=1e-5)


def test_the_basis_is_orthonormal() -> None:
    rng = np.random.default_rng(0)
    d = rng.normal(size=(200_000, 3))
    values = basis(d / np.linalg.norm(d, axis=1, keepdims=True), 3)
    assert np.allclose(4 * np.pi * values.T @ values / len(d), np.eye(16), atol=0.03)


def test_a_lens_that_distorts_is_refused() -> None:
    camera = replace(camera_at((2, 0, 0)), distortion=Distortion("brown", (0.1, 0, 0, 0)))
    with pytest.raises(JobError, match="rendered by pinhole cameras; this one has brown distortion"):
        render(random_field(3), camera)


def gradients(field: GaussianField, view: View = VIEW, seed: int = 0):
    """Raster, images' gradient and the field's gradient."""
    arrays = arrays_of(field)
    raster = rasterise(arrays, pinhole_of(view, np.zeros(3), 0.05))
    weights = np.random.default_rng(seed).normal(size=(10, view.height, view.width)).astype(np.float32)
    return raster, weights, backpropagate(arrays, raster, weights)


@pytest.mark.parametrize("degree", [0, 3])
def test_gradients_are_those_of_torch_autograd(degree: int) -> None:
    from yesnt.gaussians.torch_render import TorchField, render_tiles

    field = replace(random_field(40, degree, seed=3), filter_3d=np.full(40, 0.03, np.float32))
    raster, weights, found = gradients(field)
    torch_field = TorchField.of(arrays_of(field), "float64")
    images = render_tiles(torch_field, raster.pinhole, raster.lists)[:, : VIEW.height, : VIEW.width]
    assert np.abs(images.detach().numpy() - raster.images[:10]).max() < 5e-5
    (images * images.new_tensor(weights)).sum().backward()
    for name in ("positions", "log_scales", "rotations", "opacity_logits", "harmonics"):
        expected = getattr(torch_field, name).grad.numpy()
        assert np.abs(getattr(found, name) - expected).max() < 2e-5 * np.abs(expected).max(), name
    assert (found.screen > 0).mean() > 0.5


def test_autograd_agrees_with_finite_differences_of_the_reference() -> None:
    """The chain: kernels against autograd above, autograd against differences of the NumPy reference here."""
    field = random_field(6, 1, seed=11)
    view = view_at((2, -1, 0.7), (16, 16), 14.0)
    raster, weights, found = gradients(field, view)
    weights[9] = 0  # the median jumps between Gaussians

    def loss(changed: GaussianField) -> float:
        from yesnt.gaussians.reference import composite

        s = composite(changed, view, 0.05)
        z, origin = s.z - raster.pinhole.reference_z * s.alpha, raster.pinhole.reference_z
        square = s.z_squared - 2 * origin * s.z + origin**2 * s.alpha
        images = [*np.moveaxis(s.color, -1, 0), *np.moveaxis(s.normal, -1, 0), s.alpha, z, square]
        return float((np.stack(images) * weights[:9]).sum())

    found = backpropagate(arrays_of(field), raster, weights)
    for name, step in (("positions", 2e-4), ("log_scales", 2e-3), ("opacity_logits", 2e-3), ("harmonics", 2e-3)):
        direction = np.random.default_rng(1).normal(size=getattr(field, name).shape)
        moved = [loss(replace(field, **{name: getattr(field, name) + s * step * direction})) for s in (1, -1)]
        expected = (moved[0] - moved[1]) / (2 * step)
        assert np.isclose((getattr(found, name) * direction).sum(), expected, rtol=0.03, atol=0.02), name


def test_the_bits_do_not_depend_on_the_number_of_threads() -> None:
    field, view = random_field(700, 1, seed=8), view_at((2, -1, 0.7), (200, 160), 180.0)
    results, before = [], numba.get_num_threads()
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            raster, _, found = gradients(field, view)
            results.append([raster.images.tobytes(), *(np.asarray(part).tobytes() for part in found)])
    finally:
        numba.set_num_threads(before)
    assert results[0] == results[1]


def test_an_empty_field_renders_nothing() -> None:
    empty = random_field(3).select(np.zeros(3, bool))
    assert render(empty, Camera(8, 8, 9, 9, 4, 4, {0: np.eye(4)})).alpha.sum() == 0
