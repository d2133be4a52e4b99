"""Which pictures of a moment can be used: one that shows nothing, or nothing but damage, is left out by name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from yesnt.decompose.evidence.records import View

ENOUGH = 2 / 3
"""Share of the cameras whose pictures a moment needs."""

DAMAGED = 0.1
"""Share of the matte's pixels that are NaN or infinite from which a picture is not used."""


def faults_of(views: Iterable[View]) -> dict[str, str]:
    """Camera -> why its picture cannot be used; cameras whose pictures can be used are not in it."""
    found = {view.name: fault_of(view) for view in views}
    return {name: fault for name, fault in found.items() if fault}


def fault_of(view: View) -> str:
    """Why a picture cannot be used; "" if it can.

    A subject that reflects no light at all is not known: a picture that is zero inside the matte is a lost one.
    """
    inside = view.matte > 0.5
    if not inside.any():
        return "its matte is empty"
    fine = np.isfinite(view.radiance[inside]).all(axis=-1)
    if (damaged := 1 - float(fine.mean())) > DAMAGED:
        return f"{100 * damaged:.0f} % of its pixels inside the matte are NaN or infinite"
    return "its picture is black inside the matte" if view.radiance[inside][fine].max() <= 0 else ""


def enough(count: int, of: int) -> bool:
    """Whether a moment can be reconstructed from `count` usable cameras of `of`."""
    return count >= max(min(2, of), math.ceil(ENOUGH * of - 1e-9))


def said_of(faults: Mapping[str, str]) -> str:
    """The faults as one text, cameras with the same fault together."""
    alike: dict[str, list[str]] = {}
    for name, fault in faults.items():
        alike.setdefault(fault, []).append(name)
    return "; ".join(f"{', '.join(names)}: {fault}" for fault, names in alike.items())
