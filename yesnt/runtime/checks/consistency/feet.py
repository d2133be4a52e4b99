"""Compares the height of the ground that a job gives with the feet of the proxies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from yesnt.core.set_input import SetInput
from yesnt.relight import ProxyScene
from yesnt.scene.ground import stance

_APART = 0.02
"""Share of the subject's height by which its feet may be off the ground: soles of a decimated proxy are 1 % off."""


def feet(scene: ProxyScene) -> dict[str, float]:
    """`contact`: world z of the lowest contact, metres; `height`: of the proxy, metres."""
    span = scene.vertices[:, 2]
    return {"contact": stance(scene.vertices, scene.faces).contact, "height": float(span.max() - span.min())}


def of_ground(given: SetInput | None, facts: Sequence[Mapping[str, Any]], where: str) -> Iterable[str]:
    """Warns of a height of the ground that the feet contradict.

    Args:
        given: the job's set; a height that is fitted, a mesh and a scene are not looked at.
        facts: of `feet`, by frame.
        where: the frames.
    """
    if given is None or not isinstance(given.ground, float) or not facts:
        return
    contact, height = min(one["contact"] for one in facts), max(one["height"] for one in facts)
    above = contact - given.ground
    if abs(above) <= _APART * height:
        return
    apart = f"{abs(above):.3g} m {'above' if above > 0 else 'below'} `ground: {given.ground:g}`"
    result = "it floats, unless it is in the air there" if above > 0 else "it stands inside the ground"
    yield (
        f"set and proxy: the feet of the subject are {apart} ({where}): {result}; "
        f"`ground: {contact:.3g}` or `ground: auto` puts the ground under them"
    )
