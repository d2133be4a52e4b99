"""Weights of the perceptual networks: of ST-LPIPS from the extra `yesnt[metrics]`, of LPIPS from the user's file."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from yesnt.core.errors import CorruptError, JobError

if TYPE_CHECKING:
    from yesnt.metrics.perceptual import PerceptualNet

STLPIPS_WEIGHTS = "weights/vST0.0/alex_shift_tolerant.pth"
"""Inside the package `stlpips_pytorch`, which is never imported: its code has dependencies that we do not need."""


def stlpips_weights() -> Path | None:
    """The ST-LPIPS weights of the installed extra, or None."""
    spec = find_spec("stlpips_pytorch")
    roots = [] if spec is None else list(spec.submodule_search_locations or ())
    found = [Path(root) / STLPIPS_WEIGHTS for root in roots]
    return next((path for path in found if path.is_file()), None)


@lru_cache(maxsize=2)
def open_nets(lpips: Path | None) -> tuple[PerceptualNet, ...]:
    """The perceptual networks whose weights are present: ST-LPIPS first, then the user's LPIPS.

    Args:
        lpips: a saved state_dict of the whole LPIPS model with AlexNet, or None.

    Raises:
        JobError: the user's file cannot be read.
        CorruptError: the weights are of another network.
    """
    import torch

    from yesnt.metrics.perceptual import PerceptualNet

    nets = []
    for path in (stlpips_weights(), lpips):
        if path is None:
            continue
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except (OSError, RuntimeError, ValueError, EOFError) as error:
            raise JobError(
                f"The weights cannot be read ({error})", str(path), "a state_dict", "save it again"
            ) from error
        if not isinstance(state, dict):
            raise CorruptError("The weights hold no state_dict", str(path), "names and tensors", "save it again")
        nets.append(PerceptualNet(state))
    return tuple(nets)
