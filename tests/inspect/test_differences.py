"""Differences of two sets of fields: settings by name and value, files by role, other stages by name, no digests."""

from __future__ import annotations

from typing import Any

import pytest

from yesnt.inspect.differences import OTHER_JOB, Differences, differences

ONE, TWO = "0123456789abcdef" * 2, "fedcba9876543210" * 2
OLD: dict[str, Any] = {
    "stage": "relight", "version": 3, "size": [40, 32], "settings": {"relight": {"texels": 8}},
    "inputs": {"plate": ONE}, "upstream": {"solve": ONE},
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "causes", "follows"),
    [
        ({}, (), ()),
        ({"settings": {"relight": {"texels": 9}}}, ("relight.texels was 8, is 9",), ()),
        ({"settings": {}}, ("relight was {'texels': 8}, is not set",), ()),
        ({"settings": {"relight": {"texels": 8, "rows": 2}}}, ("relight.rows was not set, is 2",), ()),
        ({"inputs": {"plate": TWO}}, ("plate: its file has changed",), ()),
        ({"inputs": {"plate": ONE, "proxy": TWO}}, ("proxy: it was not used before",), ()),
        ({"inputs": {}}, ("plate: it is no longer used",), ()),
        ({"upstream": {"solve": TWO}}, (), ("solve",)),
        ({"size": (40, 32)}, (), ()),
        ({"size": (80, 32)}, ("size was [40, 32], is (80, 32)",), ()),
        ({"settings": {"relight": {"texels": 8}, "weights": TWO}}, ("weights has changed",), ()),
        ({"settings": {"relight": {"texels": 8}, "job": TWO}}, (OTHER_JOB,), ()),
        ({"settings": {"relight": {"texels": 9}, "job": TWO}}, ("relight.texels was 8, is 9",), ()),
        ({"settings": {"relight": {"texels": 8}, "job": TWO}, "upstream": {"solve": TWO}}, (), ("solve",)),
    ],
)
def test_what_differs_is_said(change: dict[str, Any], causes: tuple[str, ...], follows: tuple[str, ...]) -> None:
    assert differences(OLD, {**OLD, **change}) == Differences(causes, follows)


def test_another_version_is_the_whole_reason() -> None:
    found = differences(OLD, {**OLD, "version": 4, "settings": {}})
    assert found.causes == ("another version of yesnt made it: the stage's version was 3, is 4",)
