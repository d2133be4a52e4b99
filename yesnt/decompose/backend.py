"""What a decomposition model must offer, whoever made it: one protocol for the embedded and the large backends."""

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
        name: SPDX identifier, or the publisher's own name of the licence.
        commercial: False if the weights must not be used commercially; such a backend needs `--accept-license NAME`.
    """

    name: str
    commercial: bool


@dataclass(frozen=True)
class Footprint:
    """What one call of a backend holds; lets a run be planned before anything is opened.

    Attributes:
        patch: side of a patch in pixels; None: the whole frame at the model's own size.
        align: patch origins are multiples of this.
        nfe: network evaluations of one member of one patch.
        window: frames of a call of a video backend; 0: frames are drawn apart.
        overlap: frames that neighbouring windows share at least.
        predicts_mean: the backend says what to expect (`MeanPredictor`), so that with a tolerance no patch gets more than the
            first members.
    """

    patch: int | None
    align: int
    nfe: int
    window: int = 0
    overlap: int = 0
    predicts_mean: bool = False


class Backend(Protocol):
    """A conditional sampler of (roughness, metallic) patches.

    The two methods exist apart because the first is paid once per patch and the second once per member. Every call has
    exactly `batch` rows (callers pad): a network called with other batch sizes differs in the last bits, and resumed
    work must not. A row's result depends on that row alone.

    Attributes:
        name: the word in the job file.
        licence: of the weights.
        patch: side of a patch P in pixels.
        align: patch origins are multiples of this, and P is one: networks that work at a fraction of the resolution
            then see the same grid, and pooled noise the same values, in every patch.
        batch: rows B of every call.
        noise_sigmas: one entry per noise plane, C in all: the Gaussian blur in pixels of that plane of the full-frame
            noise field, 0 for white noise (see `yesnt.decompose.noise_planes`).
        nfe: network evaluations that one `sample` call spends per row.
        weights_digest: hexadecimal digest of the weights.
    """

    @property
    def name(self) -> str:
        """The word in the job file."""
        ...

    @property
    def licence(self) -> Licence:
        """Terms of the weights."""
        ...

    @property
    def patch(self) -> int:
        """Side of a patch P in pixels."""
        ...

    @property
    def align(self) -> int:
        """What patch origins, and P, are multiples of."""
        ...

    @property
    def batch(self) -> int:
        """Rows B of every call."""
        ...

    @property
    def noise_sigmas(self) -> tuple[float, ...]:
        """Blur in pixels of each of the C noise planes, 0 for white noise."""
        ...

    @property
    def nfe(self) -> int:
        """Network nfe that one `sample` call spends per row."""
        ...

    @property
    def weights_digest(self) -> str:
        """Hexadecimal digest of the weights."""
        ...

    def encode(self, rgb: torch.Tensor, matte: torch.Tensor, context: ContextBatch) -> torch.Tensor:
        """What sampling needs to know of the patches.

        Args:
            rgb: [B, 3, P, P] float32, linear Rec.709, straight, 0 where the matte is 0.
            matte: [B, 1, P, P] float32 coverage.
            context: the whole subject in small and where on it each patch lies; who draws large patches may do without.

        Returns:
            [B, ...] condition; rows may be gathered into other batches of B rows.
        """
        ...

    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """SamplePairs one member.

        Args:
            condition: [B, ...] rows of what `encode` returned.
            noise: [B, C, P, P] standard normal planes.

        Returns:
            [B, 2, P, P] float32 roughness (Disney's r) and metallic in [0, 1].
        """
        ...


@runtime_checkable
class MeanPredictor(Protocol):
    """What a backend offers besides, if it knows the mean of its draws without drawing."""

    def predict_mean(self, condition: torch.Tensor) -> torch.Tensor:
        """The expected roughness and metallic [B, 2, P, P] in [0, 1] of rows that `encode` returned."""
        ...


@runtime_checkable
class GlobalPredictor(Protocol):
    """What a backend offers besides, if it wants to see the whole subject before its patches.

    Attributes:
        auxiliary_side: side in pixels of the picture that it is shown; 0: it asks for none.
    """

    @property
    def auxiliary_side(self) -> int:
        """Side of the picture in pixels."""
        ...

    def predict_auxiliary(self, picture: torch.Tensor) -> torch.Tensor:
        """Looks at the whole subject [1, 4, side, side]; `encode` is told the answer [1, C, s, s] with every patch."""
        ...


@dataclass(frozen=True)
class Clip:
    """Frames of one window in order; a short one repeats its last frame, so that every clip is as long as the model's.

    Attributes:
        rgb: [F, H, W, 3] linear Rec.709, straight, 0 where the matte is 0.
        matte: [F, H, W] coverage.
        frames: frame number of each; a repeated one counts on, so that its noise is its own.
    """

    rgb: Float32
    matte: Float32
    frames: tuple[int, ...]


class VideoBackend(Protocol):
    """A conditional sampler of (roughness, metallic) clips: frames of a window are drawn together.

    Attributes:
        name: the word in the job file.
        licence: of the weights.
        footprint: frames of a window, nfe of a member.
        weights_digest: hexadecimal digest of the weights.
    """

    @property
    def name(self) -> str:
        """The word in the job file."""
        ...

    @property
    def licence(self) -> Licence:
        """Terms of the weights."""
        ...

    @property
    def footprint(self) -> Footprint:
        """Frames of a window, nfe of a member."""
        ...

    @property
    def weights_digest(self) -> str:
        """Hexadecimal digest of the weights."""
        ...

    def draw(self, clip: Clip, seed: int, members: Sequence[int], settings: EnsembleSettings) -> Iterator[Float32]:
        """SamplePairs members one after another.

        Args:
            clip: `footprint.window` frames.
            seed: the job's seed; a member depends on it, on the clip's frame numbers and on its own number alone.
            members: numbers k.
            settings: overlap of patches, and whether members come in opposite pairs, where the model lets us choose.

        Yields:
            [F, 2, H, W] roughness (Disney's r) and metallic in [0, 1].
        """
        ...
