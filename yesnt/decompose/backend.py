"""What a decomposition model must offer, whoever made it: one protocol for the embedded and the large backends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Licence:
    """Terms of a backend's weights.

    Attributes:
        name: SPDX identifier, or the publisher's own name of the licence.
        commercial: False if the weights must not be used commercially; such a backend needs `--accept-license NAME`.
    """

    name: str
    commercial: bool


class Backend(Protocol):
    """A conditional sampler of (roughness, metallic) patches.

    The two methods exist apart because the first is paid once per patch and the second once per member. Every call has
    exactly `batch` rows (callers pad): a network called with other batch sizes differs in the last bits, and resumed
    work must not. A row's result depends on that row alone.

    Attributes:
        name: the word in the job file.
        version: of code and sampling parameters; part of the record's key.
        licence: of the weights.
        patch: side of a patch P in pixels.
        align: patch origins are multiples of this, and P is one: networks that work at a fraction of the resolution
            then see the same grid, and pooled noise the same values, in every patch.
        batch: rows B of every call.
        noise_sigmas: one entry per noise plane, C in all: the Gaussian blur in pixels of that plane of the full-frame
            noise field, 0 for white noise (see `yesnt.decompose.noise_planes`).
        evaluations: network evaluations that one `sample` call spends per row.
        weights_digest: hexadecimal digest of the weights.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def version(self) -> str: ...  # noqa: D102
    @property
    def licence(self) -> Licence: ...  # noqa: D102
    @property
    def patch(self) -> int: ...  # noqa: D102
    @property
    def align(self) -> int: ...  # noqa: D102
    @property
    def batch(self) -> int: ...  # noqa: D102
    @property
    def noise_sigmas(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def evaluations(self) -> int: ...  # noqa: D102
    @property
    def weights_digest(self) -> str: ...  # noqa: D102

    def encode(self, rgb: torch.Tensor, matte: torch.Tensor) -> torch.Tensor:
        """What sampling needs to know of the patches.

        Args:
            rgb: [B, 3, P, P] float32, linear Rec.709, straight, 0 where the matte is 0.
            matte: [B, 1, P, P] float32 coverage.

        Returns:
            [B, ...] condition; rows may be gathered into other batches of B rows.
        """
        ...

    def sample(self, condition: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Draws one member.

        Args:
            condition: [B, ...] rows of what `encode` returned.
            noise: [B, C, P, P] standard normal planes.

        Returns:
            [B, 2, P, P] float32 roughness (Disney's r) and metallic in [0, 1].
        """
        ...
