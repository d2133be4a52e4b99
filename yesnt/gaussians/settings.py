"""How a field is fitted: every number has a unit and was chosen by measurement (docs/method.md section 2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from yesnt.gaussians.losses import LossWeights


@dataclass(frozen=True)
class FitSettings:
    """A fit of one frame.

    Attributes:
        steps: pictures that are looked at; one step each.
        count: Gaussians at the start.
        most: Gaussians that splitting may reach.
        degree: of the harmonics, 0 to 3.
        seed: of the order of cameras and the choice of points.
        half: share of the steps at half resolution, at first; 1: all, also of frames that start from another.
        position_rate: Adam's learning rate of positions, of the subject's height a step, at the start.
        scale_rate, rotation_rate, opacity_rate: of log scales, quaternions and opacity logits.
        color_rate: of the constant harmonics; the others have a tenth of it.
        last_rate: what remains of the position rate at the end; the other rates stop at a fifth.
        every: steps between two rounds of splitting and pruning.
        split_from, split_until: shares of the steps between which Gaussians are split.
        growth: most new Gaussians of a round, as a share.
        geometry_from: share of the steps from which losses of depth and normals count.
        thinnest: least standard deviation of a Gaussian, in pixels at the subject.
        near: near plane, metres.
        check: steps between two looks at the held-out cameras.
        stop_psnr: held-out PSNR at which the fit ends early, dB; None: never.
        patience: looks without a gain of 0.02 dB after which the fit ends early; 0: never.
        weights: of the losses.
    """

    steps: int = 5000
    count: int = 10_000
    most: int = 20_000
    degree: int = 1
    seed: int = 0
    half: float = 0.25
    position_rate: float = 1e-3
    scale_rate: float = 5e-3
    rotation_rate: float = 2e-3
    opacity_rate: float = 0.03
    color_rate: float = 4e-3
    last_rate: float = 0.02
    every: int = 250
    split_from: float = 0.08
    split_until: float = 0.6
    growth: float = 0.25
    geometry_from: float = 0.2
    thinnest: float = 0.2
    near: float = 0.05
    check: int = 250
    stop_psnr: float | None = None
    patience: int = 0
    weights: LossWeights = LossWeights()  # noqa: RUF009 (frozen)

    def following(self, steps: int = 800) -> FitSettings:
        """For a frame that starts from the field of a neighbouring one: half resolution only if always.

        Args:
            steps: of such a frame; never more than a first frame takes.
        """
        steps = min(steps, self.steps)
        return replace(
            self, steps=steps, half=float(self.half == 1), split_from=0.0, geometry_from=0.0,
            position_rate=self.position_rate / 2,
        )  # fmt: skip
