"""A model is loaded once in a worker, however many frames it decomposes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.tasks import decompose


def test_a_model_is_loaded_once_for_all_frames_of_a_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, real = [], decompose.open_backend

    def counted(*arguments: object) -> object:
        opened.append(arguments)
        return real(*arguments)  # type: ignore[arg-type]

    decompose._backend.cache_clear()
    monkeypatch.setattr(decompose, "open_backend", counted)
    shot = write_tiny_shot(tmp_path / "s", 3, (24, 16), decompose={"samples": 2})
    run_here(shot, "decompose")
    assert len(list((tmp_path / "s/out/run/records/decompose").glob("[0-9]*.json"))) == 3
    assert len(opened) == 1
