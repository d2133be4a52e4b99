"""What of the product runs on CUDA, each beside the same result by the CPU's reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.decompose.evidence.test_likelihood import random_case
from tests.gaussians.scenes import random_field, view_at
from tests.relight.scenes import sky
from tests.relight.test_kernels import pixels
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.evidence.fit import negative_log_likelihood
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.decompose.evidence.torch_fit import negative_log_likelihood_torch
from yesnt.decompose.global_context import ContextBatch
from yesnt.gaussians.rasterise import arrays_of, backpropagate, pinhole_of, rasterise
from yesnt.gaussians.torch_render import TorchField, render_tiles
from yesnt.relight import prepare_light
from yesnt.relight.kernels import sum_lobes
from yesnt.relight.torch_sum import sum_lobes_torch

Arrays = dict[str, Any]


@dataclass(frozen=True)
class Path:
    """One path.

    Attributes:
        name: in the table.
        reference: computes the arrays on the CPU, by the kernels that have tests of their own.
        run: computes the same arrays on a torch device.
        tolerance: largest difference over the largest value of an array.
    """

    name: str
    reference: Callable[[], Arrays]
    run: Callable[[str], Arrays]
    tolerance: float


def paths(small: bool) -> list[Path]:
    """All paths; `small` takes a second on a CPU and is for the test of this script."""
    lobes = [lobe_path(64 if small else 2000, brdf) for brdf in ("default", "paper")]
    size, count = ((45, 37), 40) if small else ((96, 64), 400)
    return [*lobes, evidence_path(64 if small else 4000), *gaussian_paths(size, count), *model_paths(64)]


def lobe_path(count: int, brdf: str) -> Path:
    """Lobe sums of relighting (`engine: torch`), with clusters that are occluded and light from the proxy."""
    light, rng = prepare_light(sky(32), 2048, 32), np.random.default_rng(0)
    roughness = rng.uniform(0.05, 1, count).astype(np.float32)
    lobes = pixels(roughness, np.float32(0.4), count=count).lobes(slice(0, count), brdf, "lambert")
    hidden, bounce = rng.random((count, 32)) < 0.3, rng.random((3, count, 32)).astype(np.float32)
    filtered = brdf != "paper"
    return Path(
        f"relight lobe sums, {brdf}",
        lambda: {"sums": sum_lobes(lobes, light, hidden, bounce, filtered)},
        lambda device: {"sums": sum_lobes_torch(lobes, light, hidden, bounce, filtered, device)},
        1e-4,
    )


def evidence_path(count: int) -> Path:
    """Likelihood of the evidence (`evidence: {knobs: {engine: torch}}`) of points that five cameras see."""
    seen, of = random_case(count)
    settings = EvidenceSettings()
    return Path(
        "evidence, likelihood",
        lambda: {"cost": negative_log_likelihood(seen, of, settings)},
        lambda device: {"cost": negative_log_likelihood_torch(seen, of, settings, device=device)},
        1e-4,
    )


def gaussian_paths(size: tuple[int, int], count: int) -> list[Path]:
    """Images of a Gaussian field, and the gradient of a sum over them."""
    view = view_at((2, -1, 0.7), size, 0.9 * size[0])
    arrays = arrays_of(random_field(count, 3, seed=3, thin=0.5))
    raster = rasterise(arrays, pinhole_of(view, np.zeros(3), 0.05))
    weights = np.random.default_rng(0).normal(size=(10, view.height, view.width)).astype(np.float32)
    names = ("positions", "log_scales", "rotations", "opacity_logits", "harmonics")

    def images(device: str) -> tuple[TorchField, Any]:
        field = TorchField.of(arrays, device=device)
        return field, render_tiles(field, raster.pinhole, raster.lists)[:, : view.height, : view.width]

    def forward(device: str) -> Arrays:
        return {"images": images(device)[1].detach().cpu().numpy()[:9]}

    def backward(device: str) -> Arrays:
        field, found = images(device)
        (found * found.new_tensor(weights)).sum().backward()
        return {name: getattr(field, name).grad.cpu().numpy() for name in names}

    def expected() -> Arrays:
        gradient = backpropagate(arrays, raster, weights)
        return {name: getattr(gradient, name) for name in names}

    # The median depth steps from one Gaussian to the next where rounding moves half the opacity: not compared.
    return [
        Path("Gaussian images", lambda: {"images": rasterise(arrays, raster.pinhole).images[:9]}, forward, 1e-3),
        Path("Gaussian gradients", expected, backward, 5e-3),
    ]


def model_paths(side: int) -> list[Path]:
    """The embedded model: auxiliary prediction, mean, and members from fixed noise."""

    def run(device: str) -> Arrays:
        import torch

        generator, backend = torch.Generator().manual_seed(0), EmbeddedBackend(device=device)
        rgb, matte = torch.rand((1, 3, side, side), generator=generator), torch.ones((1, 1, side, side))
        image = torch.cat([rgb, matte], 1)
        location = torch.tensor([[0.0, 0.0, 1.0]])
        auxiliary = backend.predict_auxiliary(image)
        condition = backend.encode(rgb, matte, ContextBatch(image, location, auxiliary))
        noise = torch.randn((1, len(backend.noise_sigmas), side, side), generator=generator)
        found = {"auxiliary": auxiliary, "mean": backend.predict_mean(condition)}
        found["members"] = backend.sample(condition, noise)
        return {name: one.cpu().numpy() for name, one in found.items()}

    return [Path("embedded model", lambda: run("cpu"), run, 1e-2)]
