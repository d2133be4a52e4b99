"""Small facts about input files, remembered by the digests of the files that they were computed from.

What a check found in a picture, or how many patches see its matte, costs decoding it. A fact never goes stale: its key
holds everything that it depends on. The memory may be deleted at any time and is ignored where it is damaged.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from yesnt.io.file_digests import save_memory

SPARE = 4
"""Facts that are kept, as a multiple of those that were asked for: a changed setting that is set back finds them."""


class FactCache:
    """Facts by key, in a JSON file between runs; safe to use from several threads.

    Args:
        memory: that file, `out/run/facts.json`; it is written by `save` only.
    """

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        self._known: dict[str, Any] = _load(memory)
        self._used: dict[str, Any] = {}
        self._computed = 0

    def fetch(self, key: str, compute: Callable[[], Any]) -> Any:
        """The fact of a key, computed if it is not known.

        Args:
            key: digest of everything that the fact depends on (`records.digest_of`).
            compute: gives the fact as a JSON value; what it raises is not remembered.
        """
        if key in self._used:
            return self._used[key]
        if key in self._known:
            fact = self._known[key]
        else:
            fact = compute()
            self._computed += 1
        self._used[key] = fact
        return fact

    def knows(self, key: str) -> bool:
        """Whether a fact would not have to be computed."""
        return key in self._used or key in self._known

    def save(self) -> None:
        """Writes the memory, if something was computed."""
        if not self._computed:
            return
        spare = [name for name in self._known if name not in self._used]
        kept = spare[-SPARE * len(self._used) :]
        facts = {name: self._known[name] for name in kept} | self._used
        save_memory(self._memory, {"version": 1, "facts": facts})


def _load(memory: Path) -> dict[str, Any]:
    try:
        document = json.loads(memory.read_bytes())
        return dict(document["facts"]) if document["version"] == 1 else {}
    except (OSError, ValueError, TypeError, KeyError):
        return {}
