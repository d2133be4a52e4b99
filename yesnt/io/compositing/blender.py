"""A script for Blender that builds a compositor of the EXR sequence's layers (docs/set.md)."""

from __future__ import annotations

from pathlib import Path

from yesnt.io.compositing.sequence import LayerSequence

_SCRIPT = Path(__file__).resolve().parent / "inside_blender" / "layers.py"


def blender_script(of: LayerSequence) -> str:
    """The text of NAME_layers.py."""
    values = {"NAME": of.name, "FRAMES": of.frames, "SIZE": of.size, "ASPECT": of.aspect, "FRONT": of.front}
    values |= {"SET": of.set, "GROUPS": of.groups}
    lines = _SCRIPT.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(
        next((f"{k} = {v!r}\n" for k, v in values.items() if line.startswith(f"{k} = ")), line) for line in lines
    )
