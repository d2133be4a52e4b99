"""The short form: some seeds of each scenario that needs no cluster; `make chaos` runs all."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.chaos import scenarios
from tests.chaos.jobs import FRAMES, digests, new_job
from tests.chaos.run import Bench
from tests.in_process import run_here


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = new_job(tmp_path_factory.mktemp("chaos"), FRAMES)
    run_here(path, "composite")
    return path


@pytest.mark.parametrize("seed", range(7, 14))
def test_a_damage_is_found_and_repaired(finished: Path, tmp_path: Path, seed: int) -> None:
    shutil.copytree(finished.parent, tmp_path / "shot")
    path = tmp_path / "shot" / finished.name
    scenarios.damage(seed, path, digests(finished))


def test_a_full_disk_leaves_nothing_broken(tmp_path: Path) -> None:
    if not scenarios.can_mount(tmp_path):
        pytest.skip("no right to mount a small disk")
    path = new_job(tmp_path, 2)
    run_here(path, "composite")
    reference = digests(path)
    met = {scenarios.full_disk(pages, path, reference)["met"] for pages in (0, 20, 40, 60)}
    assert len(met - {""}) >= 2


@pytest.mark.parametrize("seed", [1, 2])
def test_odd_paths_and_clocks_change_nothing(finished: Path, tmp_path: Path, seed: int) -> None:
    scenarios.odd_surroundings(seed, tmp_path, digests(finished))


def test_the_table_of_the_long_form_names_what_failed(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.keep(scenario="damage", seed=0, passed=True, found={"kind": "flip"})
    bench.keep(scenario="damage", seed=1, passed=False, why="AssertionError: lost")
    assert bench.passed() == {("damage", 0)}
    row = next(line for line in bench.table().splitlines() if line.startswith("damage"))
    assert row.split() == "damage 1 1 1 flips; seed 1: AssertionError: lost".split()
