"""The script for cards, on the CPU."""

import numpy as np
import pytest
import torch

from tests.gpu import run
from tests.gpu.paths import Path


def test_all_paths_agree_on_the_cpu(capsys) -> None:
    assert run.main(["--device", "cpu", "--small"]) == run.AGREE
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 6
    assert not [line for line in lines if "DIFFERS" in line]


@pytest.mark.parametrize("wrong", [np.full(3, 1.1), np.full(3, np.nan), np.ones(2)])
def test_a_result_that_differs_is_said(capsys, wrong) -> None:
    path = Path("broken", lambda: {"a": np.ones(3)}, lambda device: {"a": wrong}, 1e-3)
    assert not run.check(path, "cpu")
    assert "DIFFERS" in capsys.readouterr().out


def test_without_a_card_it_says_so_and_does_not_pass(capsys, monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert run.main([]) == run.NO_DEVICE
    assert capsys.readouterr().out.startswith("Nothing was checked: torch finds no CUDA device here")
