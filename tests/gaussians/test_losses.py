"""Losses of a fit: each value is the reference's, each gradient that of finite differences of the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gaussians.scenes import view_at
from yesnt.gaussians import loss_reference as reference
from yesnt.gaussians.losses import LossWeights, view_losses
from yesnt.gaussians.targets import Target

H, W, Z0, HEIGHT = 18, 24, 2.0, 1.5
NONE = LossWeights(ssim=0, matte=0, consistency=0)
VIEW = view_at((2, 0.5, 0.4), (W, H), 30.0)


def scene(seed: int = 0) -> tuple[np.ndarray, Target]:
    """Images of a wavy surface with noise, and a target with soft edges."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:H, :W]
    matte = np.clip(8.5 - np.hypot(x - W / 2, y - H / 2), 0, 1).astype(np.float32)
    images = np.zeros((12, H, W), np.float32)
    images[:3] = rng.uniform(0, 1, (3, H, W)) * matte
    images[3:6] = rng.normal(size=(3, H, W)) * 0.3 + np.array([0.1, -0.2, -1])[:, None, None]
    images[6] = np.clip(0.9 * matte + 0.05 * rng.uniform(size=(H, W)), 0, 1)
    images[7] = images[6] * (0.05 * np.sin(x / 3) + 0.02 * y / 3 + 0.002 * rng.normal(size=(H, W)))
    images[8] = images[7] ** 2 / np.maximum(images[6], 0.05) + 0.01 * images[6]
    color = (rng.uniform(0, 1, (H, W, 3)) * matte[..., None]).astype(np.float32)
    return images, Target(VIEW, color, matte, float(matte.sum()))


def whole(images: np.ndarray, target: Target, w: LossWeights) -> float:
    """The weighted sum of the reference's losses, with the solid pixels of the undisturbed images."""
    z = (images[7] / np.maximum(images[6], 0.05) + Z0) / HEIGHT
    normal, ok = np.moveaxis(images[3:6], 0, -1), reference.solid(scene()[0][6], target)
    rest = (ok, reference.edge_weights(target.color, w.sigma), target.pixels)
    total = w.matte * reference.matte_loss(images[6], target)
    total += w.distortion * reference.distortion_loss(images[6], images[7] / HEIGHT, images[8] / HEIGHT**2, target)
    total += w.depth * reference.depth_loss(z, ok, w.delta, w.jump, target.pixels)
    total += w.normal * reference.normal_loss(normal, *rest)
    total += w.consistency * reference.consistency_loss(z, normal, ok, VIEW, target.pixels, w.jump)
    return total


CASES = {
    "matte": replace(NONE, matte=0.5),
    "distortion": replace(NONE, distortion=3.0),
    "depth": replace(NONE, depth=5.0, delta=0.02),
    "normal": replace(NONE, normal=0.3),
    "consistency": replace(NONE, consistency=0.2),
    "all": LossWeights(ssim=0, distortion=1, depth=2, normal=0.3, delta=0.02),
}


@pytest.mark.parametrize("name", CASES)
def test_a_loss_of_shape_and_its_gradient_are_those_of_the_reference(name: str) -> None:
    images, target = scene()
    weights = CASES[name]
    losses, gradient = view_losses(images, target, weights, Z0, HEIGHT)
    parts = ("matte", "distortion", "depth", "normal", "consistency")
    found = sum(getattr(weights, part) * getattr(losses, part) for part in parts)
    assert np.isclose(found, whole(images.astype(float), target, weights), rtol=1e-4)
    direction = np.zeros((12, H, W))
    direction[3:9] = np.random.default_rng(1).normal(size=(6, H, W))
    moved = [whole(images + s * 1e-5 * direction, target, weights) for s in (1, -1)]
    expected = (moved[0] - moved[1]) / 2e-5
    assert np.isclose((gradient[3:9] * direction[3:9]).sum(), expected, rtol=5e-3)


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_the_colour_loss_and_its_gradient_are_those_of_the_reference(share: float) -> None:
    images, target = scene()
    losses, gradient = view_losses(images, target, replace(NONE, ssim=share), Z0, HEIGHT)
    color = np.moveaxis(images[:3], 0, -1).astype(float)
    found = (1 - share) * losses.l1 + share * losses.dssim
    assert np.isclose(found, reference.color_loss(color, target, share), rtol=1e-4)
    direction = np.random.default_rng(2).normal(size=color.shape) * (target.matte > 0)[..., None]
    moved = [reference.color_loss(color + s * 1e-6 * direction, target, share) for s in (1, -1)]
    expected = (moved[0] - moved[1]) / 2e-6
    assert np.isclose((np.moveaxis(gradient[:3], 0, -1) * direction).sum(), expected, rtol=5e-3, atol=1e-4)


def test_opacity_outside_the_matte_is_pushed_down_and_inside_it_is_pulled_up() -> None:
    images, target = scene()
    _, gradient = view_losses(images, target, replace(NONE, matte=1.0), Z0, HEIGHT)
    assert (gradient[6][target.matte == 0] >= 0).all()
    assert gradient[6][target.matte == 0].sum() > 0
    assert gradient[6][target.matte == 1].sum() < 0


def test_losses_of_geometry_do_not_look_outside_the_matte() -> None:
    images, target = scene()
    _, gradient = view_losses(images, target, replace(CASES["all"], matte=0, distortion=0), Z0, HEIGHT)
    assert (gradient[3:9][:, target.matte < 0.99] == 0).all()


def test_a_crop_holds_the_matte_with_a_margin_and_halves_to_means_of_four() -> None:
    matte = np.zeros((H, W), np.float32)
    matte[8:11, 12:15] = 1
    target = Target.cropped(VIEW, np.repeat(matte[..., None], 3, 2), matte, margin=2)
    assert target.matte.shape == (6, 6)
    assert (target.view.cx, target.view.cy) == (VIEW.cx - 10, VIEW.cy - 6)
    half = target.halved()
    assert half.matte.tolist() == [[0, 0, 0], [0, 1, 0.5], [0, 0.5, 0.25]]
    assert half.view.fx == VIEW.fx / 2


def test_an_empty_matte_is_refused() -> None:
    from yesnt.core.errors import JobError

    with pytest.raises(JobError, match="A matte for the fit of a Gaussian field is empty"):
        Target.cropped(VIEW, np.zeros((H, W, 3), np.float32), np.zeros((H, W), np.float32))
