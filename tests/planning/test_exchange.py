"""How a shot is cut for the solver and in which order its blocks are solved."""

from __future__ import annotations

import pytest

from yesnt.core.shot import TemporalInput
from yesnt.core.stage_id import StageId
from yesnt.planning.chunks import (
    DECOMPOSING,
    DECOMPOSING_PIXEL,
    SHORTEST,
    TYPICAL_CONFIDENCE,
    Extent,
    plan_chunks,
)
from yesnt.planning.exchange import SOLVE, Exchange
from yesnt.temporal import EnergyParams
from yesnt.temporal.blocks import halo_frames, listed_bytes

SMALL, HD = Extent(384, 256), Extent(1080, 1920, 0.4)


def plan(frames: int, extent: Extent = SMALL, **temporal):
    return plan_chunks(EnergyParams(), TemporalInput(**temporal), 1e-4, frames, extent)


def test_a_shot_that_fits_into_memory_is_solved_as_one() -> None:
    found = plan(64, memory=2.0)
    assert (found.chunk, found.whole) == (64, True)
    assert Exchange(64, found).sweeps == 0
    assert found.peak_bytes <= 2e9


def test_a_longer_shot_is_cut_into_the_longest_chunks_that_fit() -> None:
    found = plan(2000, memory=2.0)
    assert SHORTEST < found.chunk < 2000
    assert found.whole
    assert found.peak_bytes <= 2e9
    assert plan(2000, memory=4.0).chunk > found.chunk
    assert plan(64, chunk=16).chunk == 16
    banded = plan(240, HD)
    assert banded.chunk == SHORTEST
    assert not banded.whole


def test_the_halo_is_half_a_chunk_and_a_quarter_where_bands_are_needed() -> None:
    needed = halo_frames(EnergyParams(), TYPICAL_CONFIDENCE, 1e-4)
    assert needed > SHORTEST
    whole, banded = plan(64, chunk=16, memory=4.0), plan(240, HD)
    assert (whole.whole, whole.halo) == (True, 8)
    assert (banded.whole, banded.chunk, banded.halo) == (False, SHORTEST, 4)
    assert plan(240, HD, halo=3).halo == 3


def test_a_chunk_of_the_job_is_used_unchanged_though_memory_does_not_suffice() -> None:
    extent = Extent(2160, 3840, 0.9)
    assert plan(240, extent, memory=0.9, chunk=SHORTEST).peak_bytes > 0.9e9
    assert plan(240, extent, memory=0.9, chunk=SHORTEST).chunk == SHORTEST
    assert plan(240, extent, memory=0.9).chunk == SHORTEST // 4


@pytest.mark.parametrize("extent", [Extent(384, 256, 0.35, 0.2), Extent(384, 256), HD])
def test_memory_does_not_grow_with_length(extent: Extent) -> None:
    decomposing = DECOMPOSING + DECOMPOSING_PIXEL * extent.height * extent.width
    peaks = [max(decomposing, plan(frames, extent).peak_bytes) for frames in (16, 256, 4000)]
    assert max(peaks) <= 1.1 * peaks[0]
    assert plan(64, Extent(384, 256, 0.35, 0.2)).chunk == 64, "a shot of the demo's size is solved as one"


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7])
def test_a_4k_shot_is_planned_within_2_gb_whatever_its_matte_fills(share: float) -> None:
    found = plan(120, Extent(2160, 3840, share), memory=2.0)
    assert found.peak_bytes <= 2e9
    assert SHORTEST // 4 <= found.chunk <= SHORTEST
    assert not found.whole


def test_joint_sweeps_come_only_where_memory_holds_at_least_a_frame() -> None:
    assert 0 < plan(64, chunk=16).joint * listed_bytes() < 2e9
    assert plan(240, Extent(2160, 3840, 0.3), memory=1.0).joint == 0


@pytest.mark.parametrize(("frames", "extent", "temporal"), [(64, SMALL, {"chunk": 16}), (240, HD, {})])
def test_every_block_is_solved_first_and_once_a_round(frames: int, extent: Extent, temporal: dict) -> None:
    found = plan(frames, extent, **temporal)
    exchange = Exchange(frames, found)
    assert exchange.sweeps == 6
    assert exchange.ends_jointly
    for chunk in exchange.blocks:
        for band in found.bands:
            solved = exchange.solved_in(chunk.index, band.index)
            assert len(solved) == 3
            assert solved[1] % 3 == (1 if (chunk.index + band.index) % 2 else 2)
            assert exchange.held_in(chunk.index, band.index)[-1] == 6
    last = exchange.blocks.index_of(frames - 1)
    assert last == len(exchange.blocks) - 1
    assert exchange.index_of(SOLVE, last) == 0, "the last, joint sweep commits all frames"
    assert exchange.index_of(StageId("solve", 3), last) == 0
    assert exchange.index_of(StageId("solve", 0, None if found.whole else 0), last) == last


def test_neighbours_are_never_solved_in_the_same_sweep() -> None:
    exchange = Exchange(240, plan(240, HD))
    for sweep in range(1, 1 + exchange.sweeps):
        found = {(chunk.index, band.index) for chunk, band in exchange.solved(sweep)}
        assert all((c + 1, b) not in found and (c, b + 1) not in found for c, b in found)
        assert bool(found) != exchange.is_joint(sweep)


def test_without_room_for_joint_sweeps_two_colours_go_on_by_turns() -> None:
    found = plan(240, Extent(2160, 3840, 0.3), memory=1.0, sweeps=5)
    exchange = Exchange(240, found)
    assert exchange.sweeps == 5
    assert not exchange.ends_jointly
    assert exchange.solved_in(0, 0) == (0, 2, 4)
    assert exchange.solved_in(1, 0) == (0, 1, 3, 5)
    assert exchange.index_of(SOLVE, 7) == 7
