"""Evaluates the Nuke scripts that the product writes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
LONG = {"R": "red", "G": "green", "B": "blue", "A": "alpha"}


class Nuke:
    """Evaluates the few nodes that the script uses, as Nuke's reference guide describes them."""

    def __init__(self, channels: Mapping[str, F32], factors: Mapping[str, float] | None = None) -> None:
        self.factors = factors or {}  # what the user sets a factor to
        self._file = {re.sub(r"\.([RGBA])$", lambda m: f".{LONG[m[1]]}", name): p for name, p in channels.items()}
        self._file |= {LONG[name]: plane for name, plane in channels.items() if name in LONG}
        self._stack: list[dict[str, F32]] = []
        self._named: dict[str, dict[str, F32]] = {}
        self.reads: list[str] = []

    def run(self, script: str) -> F32:
        for kind, body, name, pushed in re.findall(
            r"^(\w+) \{\n(.*?)^\}$|^set (\w+) \[stack 0\]$|^push \$(\w+)$", script, re.M | re.S
        ):
            if name:
                self._named[name] = self._stack[-1]
            elif pushed:
                self._stack.append(self._named[pushed])
            elif kind != "Root":
                knobs = dict(re.findall(r"^ (\w+) (.*)$", body, re.M))
                self._stack.append(getattr(self, f"_{kind.lower()}")(knobs))
        result = self._stack.pop()
        return np.stack([result[c] for c in LONG.values()], axis=-1)

    def _read(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        self.reads.append(knobs["file"])
        assert knobs["raw"] == "true"  # the layers are scene-linear: no conversion
        return self._file

    def _expression(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        given = self._stack.pop()
        out = dict(given)
        for i, channel in enumerate(LONG.values()):
            text = knobs[f"expr{i}"].strip('"')
            names = sorted(set(re.findall(r"[a-z_]+(?:\.\w+)?", text)) - {"max"}, key=len, reverse=True)
            for k, name in enumerate(names):
                text = re.sub(rf"(?<![\w.]){re.escape(name)}(?![\w.])", f"v[{k}]", text)
            values = [given[name] for name in names]
            out[channel] = np.broadcast_to(
                eval(text, {"max": np.maximum, "v": values}), next(iter(self._file.values())).shape
            )
        return out

    def _multiply(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        assert knobs["channels"] == "rgb"
        given, factor = self._stack.pop(), np.float32(self.factors.get(knobs["name"], float(knobs["value"])))
        return {**given, **{c: given[c] * factor for c in ("red", "green", "blue")}}

    def _merge2(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        """Input 0, B, is the last that was pushed; merges act on red, green, blue and alpha."""
        b, a = self._stack.pop(), self._stack.pop()
        cover = a["alpha"]
        operation: dict[str, Callable[[F32, F32], F32]] = {
            "multiply": lambda a, b: a * b,
            "plus": lambda a, b: a + b,
            "over": lambda a, b: a + b * (1 - cover),
            "stencil": lambda a, b: b * (1 - cover),
        }
        return {**b, **{c: operation[knobs["operation"]](a[c], b[c]) for c in LONG.values()}}
