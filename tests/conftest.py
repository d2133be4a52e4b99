"""Fixtures that every test may use: a tiny shot with everything in it, made from formulas."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.tiny_shot import write_tiny_shot


@pytest.fixture(autouse=True)
def _same_environment() -> Iterator[None]:
    """Restores the environment after each test: Dask's nannies set variables of the process that starts them."""
    before = dict(os.environ)
    yield
    changed = {name for name in {*before, *os.environ} if before.get(name) != os.environ.get(name)}
    for name in changed - {"PYTEST_CURRENT_TEST"}:
        if name in before:
            os.environ[name] = before[name]
        else:
            del os.environ[name]


@pytest.fixture
def tiny_shot(tmp_path: Path) -> Path:
    """Job file of a 4-frame shot of a moving sphere, materials given as passes."""
    return write_tiny_shot(tmp_path / "shot")


@pytest.fixture(scope="session")
def tiny_stable_diffusion() -> Callable:
    """Builds random parts; a test saves them in the layout of its checkpoint."""
    pytest.importorskip("diffusers")
    from tests.tiny_checkpoints import tiny_stable_diffusion

    return tiny_stable_diffusion


@pytest.fixture(scope="session")
def tiny_diffusion_renderer() -> Callable:
    """Builds the checkpoint in a folder."""
    pytest.importorskip("diffusers")
    from tests.tiny_checkpoints import tiny_diffusion_renderer

    return tiny_diffusion_renderer
