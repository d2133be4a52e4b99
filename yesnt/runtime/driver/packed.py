"""What all tasks of a run share, packed once: a job of 10,000 frames would be 30 kB in every message."""

from __future__ import annotations

import bz2
import pickle
from dataclasses import dataclass
from functools import lru_cache
from typing import Any


@dataclass(frozen=True)
class Packed:
    """A compressed pickle of a value.

    Attributes:
        data: its bytes.
    """

    data: bytes

    @classmethod
    def of(cls, value: Any) -> Packed:
        """Packs a value."""
        return cls(bz2.compress(pickle.dumps(value)))

    def unpack(self) -> Any:
        """The value; a process unpacks it once."""
        return _unpack(self.data)


@lru_cache(maxsize=4)
def _unpack(data: bytes) -> Any:
    return pickle.loads(bz2.decompress(data))
