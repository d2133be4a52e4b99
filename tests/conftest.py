"""Fixtures that every test may use: a tiny shot with everything in it, made from formulas."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tiny_shot import write_tiny_shot


@pytest.fixture
def tiny_shot(tmp_path: Path) -> Path:
    """Job file of a 4-frame shot of a moving sphere, materials given as passes."""
    return write_tiny_shot(tmp_path / "shot")
