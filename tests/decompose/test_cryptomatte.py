"""Identifiers and coverage of the Cryptomatte specification."""

from __future__ import annotations

import numpy as np
import pytest

from yesnt.decompose.cryptomatte import coverage, identifier

BLENDER = {"head": 0x95A53FC9, "ball": 0x645D3BC4, "vase": 0x6AAA21AA, "object": 0x055EC73D}
"""From the manifest of a picture that Blender 5.0.1 rendered."""


def as_float(bits: int) -> np.float32:
    return np.array([bits], np.uint32).view(np.float32)[0]


@pytest.mark.parametrize("name", BLENDER)
def test_identifiers_are_blenders(name: str) -> None:
    assert identifier(name) == BLENDER[name]


def test_no_identifier_is_a_float_that_programs_change() -> None:
    floats = np.array([identifier(f"object {i}") for i in range(4000)], np.uint32).view(np.float32)
    assert np.isfinite(floats).all()
    assert (np.abs(floats) >= np.finfo(np.float32).tiny).all(), "no zero and no denormal"


def test_a_hash_without_a_usable_exponent_has_its_lowest_exponent_bit_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    for bits, changed in ((0x007FFFFF, 0x00FFFFFF), (0x7F800001, 0x7F000001), (0xFF812345, 0xFF012345)):
        monkeypatch.setattr("yesnt.decompose.cryptomatte.mmh3.hash", lambda *args, bits=bits, **kw: bits)
        assert identifier("any") == changed


def test_coverage_is_summed_over_all_ranks() -> None:
    belt, boots, other = (as_float(identifier(name)) for name in ("belt", "boots", "other"))
    first = np.array([[belt, boots, other, belt]], np.float32), np.array([[0.6, 1.0, 0.7, 0.5]], np.float32)
    second = np.array([[boots, 0, belt, other]], np.float32), np.array([[0.4, 0.0, 0.3, 0.5]], np.float32)
    both = {identifier("belt"), identifier("boots")}
    np.testing.assert_allclose(coverage([first, second], {identifier("belt")}), [[0.6, 0, 0.3, 0.5]])
    np.testing.assert_allclose(coverage([first, second], both), [[1, 1, 0.3, 0.5]])
    np.testing.assert_array_equal(coverage([first, second], {identifier("nobody")}), [[0, 0, 0, 0]])
