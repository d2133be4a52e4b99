"""Checkpoint files of a training."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from yesnt.core.errors import JobError

FORMAT = 2
"""Version of the file: 2 since its tensors have the names of format 2 of the weights."""


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Writes tensors and numbers atomically; `read_state` reads them."""
    part = path.with_suffix(".part")
    torch.save({"format": FORMAT, **state}, part)
    part.replace(path)


def read_state(path: Path) -> dict[str, Any]:
    """Reads what `write_state` wrote.

    Raises:
        JobError: the file has another format.
    """
    state: dict[str, Any] = torch.load(path, weights_only=True)
    found = state.pop("format", 1)  # format 1 did not state itself
    if found != FORMAT:
        raise JobError(
            f"the checkpoint has format {found}",
            str(path),
            f"format {FORMAT}",
            "finish the training with the version that began it, or delete the file to begin anew",
        )
    return state
