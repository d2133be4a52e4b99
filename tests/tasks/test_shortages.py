"""A GPU that others hold is a shortage; a frame that is too large for a free one is a failure."""

from __future__ import annotations

import pytest
import torch

from yesnt.tasks.shortages import shortage_of

GB = 1_000_000_000


@pytest.mark.parametrize(("free", "own", "busy"), [(1, 5, True), (1, 22, False), (18, 5, False)])
def test_memory_of_a_gpu_that_others_hold_is_a_shortage(
    monkeypatch: pytest.MonkeyPatch, free: int, own: int, busy: bool
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda: (free * GB, 24 * GB))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda: own * GB)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a GPU")
    found = shortage_of(torch.OutOfMemoryError("CUDA out of memory"))
    assert (found is not None) == busy
    if found is not None:
        assert str(found).startswith("The GPU is busy: other processes hold 18.0 GB of its 24.0 GB. Where: a GPU.")


def test_other_errors_are_none() -> None:
    assert shortage_of(RuntimeError("CUDA out of memory")) is None
    assert shortage_of(torch.OutOfMemoryError("no GPU here")) is None
