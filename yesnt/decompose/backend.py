"""Protocols that a decomposition backend follows, and the records that describe it. Importing this imports no torch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

    from yesnt.decompose.global_context import ContextBatch
    from yesnt.decompose.settings import EnsembleSettings

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class Licence:
    """Terms of a backend's weights.

    Attributes:
        name: SPDX identifier, or the name that the publisher gives the licence.
        commercial: whether commercial use is allowed; if not, a job needs `--accept-license NAME`.
    """

    name: str
    commercial: bool


@dataclass(frozen=True)
class Footprint:
    """Size and cost of one call of a backend, known without opening it, so that a run can be planned.

    Attributes:
        patch: side of a patch in pixels; None: the backend takes the whole frame at the size of its model.
        align: patch origins are multiples of this many pixels.
        nfe: number of function evaluations (network calls) for one member of one patch.
        window: frames that a video backend processes together; 0: the backend processes single frames.
        overlap: least number of frames that consecutive windows share.
        predicts_mean: the backend follows `MeanPredictor`. With a tolerance, no patch then gets more than the first
            round of members.
    """

    patch: int | None
    align: int
    nfe: int
    window: int = 0
    overlap: int = 0
    predicts_mean: bool = False


class Backend(Protocol):
    """Conditional sampler of roughness and metallic for patches of one frame.

    `encode` runs once per patch, `sample` once per member. Every call has exactly `batch` rows, and callers pad:
    another batch size changes the last bits of a network's output, and a resumed job must give the same bits. The
    result of a row depends on that row only.

    Attributes:
        patch: side P of a patch in pixels; a multiple of `align`.
        align: patch origins are multiples of this many pixels, so that pooled features and pooled noise fall on the
            same grid in every patch.
        batch: rows B of every call.
        noise_sigmas: Gaussian blur in pixels of each of the C noise planes, 0 for white noise
            (`yesnt.decompose.noise_planes`).
        nfe: network evaluations per row of one `sample` call.
    """

    @property
    def patch(self) -> int:
        """Side P of a patch in pixels."""
        ...

    @property
    def align(self) -> int:
        """Number of pixels that patch origins, and P, are multiples of."""
        ...

    @property
    def batch(self) -> int:
        """Rows B of every call."""
        ...

    @property
    def noise_sigmas(self) -> tuple[float, ...]:
        """Gaussian blur in pixels of each of the C noise planes, 0 for white noise."""
        ...

    @property
    def nfe(self) -> int:
        """Network evaluations per row of one `sample` call."""
        ...

    def encode(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """Computes the condition that `sample` takes.

        Args:
            rgb: [B, 3, P, P] float32, linear Rec.709, straight, 0 where the matte is 0.
            matte: [B, 1, P, P] float32 coverage in [0, 1].
            context: image of the whole subject and the location of each patch on it; a backend may ignore it.

        Returns:
            [B, ...] condition. Rows may be regrouped into other batches of B rows.
        """
        ...

    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Draws one member per row.

        Args:
            condition: [B, ...] rows that `encode` returned.
            noise: [B, C, P, P] standard normal planes.

        Returns:
            [B, 2, P, P] float32 roughness (Disney's r) and metallic in [0, 1].
        """
        ...


@runtime_checkable
class MeanPredictor(Protocol):
    """Optional part of a backend: predicts the mean of its samples without sampling."""

    def predict_mean(self, condition: torch.Tensor) -> torch.Tensor:
        """Predicts the conditional mean.

        Args:
            condition: [B, ...] rows that `encode` returned.

        Returns:
            [B, 2, P, P] float32 expected roughness and metallic in [0, 1].
        """
        ...


@runtime_checkable
class GlobalPredictor(Protocol):
    """Optional part of a backend: predicts features of the whole subject once per frame.

    Attributes:
        auxiliary_side: side S in pixels of the image of the subject that it takes; 0: these weights hold no predictor.
    """

    @property
    def auxiliary_side(self) -> int:
        """Side S in pixels of the image of the subject."""
        ...

    def predict_auxiliary(self, image: torch.Tensor) -> torch.Tensor:
        """Predicts auxiliary features, which `encode` receives in `ContextBatch.auxiliary` with every patch.

        Args:
            image: [1, 4, S, S] straight linear rgb and matte of the whole subject.

        Returns:
            [1, C, s, s] features over the same square.
        """
        ...


@dataclass(frozen=True)
class Clip:
    """Frames of one window in order. A short clip repeats its last frame up to the length that the model takes.

    Attributes:
        rgb: [F, H, W, 3] linear Rec.709, straight, 0 where the matte is 0.
        matte: [F, H, W] coverage in [0, 1].
        frames: frame number of each; repeated frames have consecutive numbers, so that each has its own noise.
    """

    rgb: Float32
    matte: Float32
    frames: tuple[int, ...]


class VideoBackend(Protocol):
    """Conditional sampler of roughness and metallic that processes the frames of a window together.

    Attributes:
        footprint: frames of a window and network evaluations of a member.
    """

    @property
    def footprint(self) -> Footprint:
        """Frames of a window and network evaluations of a member."""
        ...

    def draw(self, clip: Clip, seed: int, members: Sequence[int], settings: EnsembleSettings) -> Iterator[Float32]:
        """Draws members one after another.

        Args:
            clip: `footprint.window` frames.
            seed: seed of the job; a member depends on it, on the frame numbers of the clip and on its own number only.
            members: member numbers k.
            settings: overlap of patches and antithetic pairing, for models that allow either.

        Yields:
            [F, 2, H, W] float32 roughness (Disney's r) and metallic in [0, 1].
        """
        ...
