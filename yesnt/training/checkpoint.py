"""Checkpoint files of a training."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Writes tensors and numbers atomically; `torch.load(path, weights_only=True)` reads them."""
    part = path.with_suffix(".part")
    torch.save(dict(state), part)
    part.replace(path)
