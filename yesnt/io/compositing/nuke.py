"""A Nuke script that puts the layers of the EXR sequence together to the composite (docs/set.md)."""

from __future__ import annotations

from collections.abc import Sequence

from yesnt.io.compositing.sequence import LayerSequence

LAYER = ("red", "green", "blue")
"""Nuke's names of the channels R, G, B of a layer."""


def nuke_script(of: LayerSequence) -> str:
    """The text of NAME.nk.

    Nodes of a script take their inputs from a stack: B is the last pushed node, A the one below.
    """
    (first, last), (width, height) = of.frames, of.size
    root = _node(
        "Root", first_frame=first, last_frame=last, format=f'"{width} {height} 0 0 {width} {height} {of.aspect:g}"'
    )
    read = _node(
        "Read", inputs=0, file=f'"\\[file dirname \\[value root.name]]/{of.name}.####.exr"', first=first, last=last,
        origfirst=first, origlast=last, origset="true", raw="true", name="layers",
    )  # fmt: skip
    made = _of_set(of) if of.set else [_picked("composite", LAYER, "alpha")]
    return "".join((root, read, "set Nlayers [stack 0]\n", *made, *(_rebalanced() if of.groups else [])))


def _of_set(of: LayerSequence) -> list[str]:
    """Nodes that end in the composite of the layers of a set."""
    behind = [
        _picked("env", _layer("env"), "1"), _picked("shadow_set", ["shadow_set.Y"] * 3, "1"),
        _merge("multiply", "in_shadow"), _picked("reflection_set", _layer("reflection_set"), "0"),
        _merge("plus", "reflected"),
        _expression("behind", [f"max({channel}, 0)" for channel in LAYER], "alpha", source=""),
    ]  # fmt: skip
    relit, holdout = _picked("relit", _layer("relit"), "relit.alpha"), _picked("holdout", ["0"] * 3, "holdout.Y")
    if of.front:
        subject = [
            relit, "push $Nbehind\n", _merge("over", "subject"), "set Nsubject [stack 0]\n",
            holdout, "push $Nsubject\n", _merge("stencil", "held_out"),
            _picked("front", _layer("front"), "holdout.Y"), _merge("plus", "composite"),
        ]  # fmt: skip
    else:
        subject = [
            relit, "set Nrelit [stack 0]\n", holdout, "push $Nrelit\n", _merge("stencil", "held_out"),
            "push $Nbehind\n", _merge("over", "composite"),
        ]  # fmt: skip
    return [*behind, "set Nbehind [stack 0]\n", *subject]


def _rebalanced() -> list[str]:
    """Nodes that end in the composite of the light groups, each with a factor of its own."""
    return [
        _picked("light_sun", _layer("light_sun"), "0"), _factor("sun"),
        _picked("light_rest", _layer("light_rest"), "alpha"), _factor("rest"),
        _merge("plus", "rebalanced"),
    ]  # fmt: skip


def _factor(name: str) -> str:
    """A factor of red, green and blue."""
    return _node("Multiply", channels="rgb", value=1, name=name)


def _layer(name: str) -> list[str]:
    return [f"{name}.{channel}" for channel in LAYER]


def _picked(name: str, colors: Sequence[str], alpha: str) -> str:
    """A node that takes channels of the sequence's layers as red, green, blue and alpha."""
    return _expression(name, colors, alpha, source="push $Nlayers\n")


def _expression(name: str, colors: Sequence[str], alpha: str, source: str) -> str:
    terms = {f"expr{i}": f'"{term}"' for i, term in enumerate((*colors, alpha))}
    return source + _node("Expression", **terms, name=name)


def _merge(operation: str, name: str) -> str:
    return _node("Merge2", inputs=2, operation=operation, name=name)


def _node(kind: str, **knobs: object) -> str:
    return f"{kind} {{\n" + "".join(f" {knob} {value}\n" for knob, value in knobs.items()) + "}\n"
