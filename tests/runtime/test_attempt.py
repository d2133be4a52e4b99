"""One attempt at a task, on its worker."""

from __future__ import annotations

import sys

import pytest

from yesnt.core.stage_id import StageId
from yesnt.planning.graph import Node
from yesnt.runtime.driver.attempt import attempt
from yesnt.runtime.driver.packed import Packed


def test_sys_exit_inside_a_task_is_a_failure_of_the_task() -> None:
    node = Node(StageId("a"), 0, (1,), {})
    with pytest.raises(RuntimeError, match=r"called sys\.exit\('why'\)"):
        attempt(lambda context, node: sys.exit("why"), Packed.of({}), node)
