"""Motions of the humans: a body and a time in seconds give a pose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from yesnt.capture_stage.pose import Array, Body, arm, fist, leg, turn

Motion = Callable[[Body, float], dict[str, Array]]


def walk_and_sweep(body: Body, seconds: float) -> dict[str, Array]:
    """A slow walk on the spot while the right forearm sweeps before the chest: the embedded shot."""
    phase = 2 * np.pi * seconds / 1.15
    sweep = np.sin(np.pi * np.clip(seconds / 0.64, 0, 1) ** 1.1)
    s = np.sin(phase)
    return {
        **leg("L", 22 * s + 4, 12 + 26 * max(0.0, np.cos(phase)), 4 * s),
        **leg("R", -22 * s + 4, 12 + 26 * max(0.0, -np.cos(phase)), -4 * s),
        **arm(body, "L", 26, -20 * s, 0, 22 + 8 * s),
        **arm(body, "R", 24, 8 + 18 * sweep, 4 + 60 * sweep, 70 + 14 * sweep),
        "spine03": turn("z", 7 * s) @ turn("y", 2 * np.cos(phase)),
        "neck01": turn("z", -9 * s),
        "head": turn("x", 5 * np.sin(phase / 2)),
    }


def guard(body: Body, seconds: float) -> dict[str, Array]:
    """A boxer's stance, still."""
    return box(body, 0.0)


def box(body: Body, seconds: float) -> dict[str, Array]:
    """Straight punches, left then right, out of a guard, with a shift of the trunk."""
    left = np.clip(np.sin(2 * np.pi * seconds), 0, 1) ** 1.5
    right = np.clip(np.sin(2 * np.pi * (seconds - 0.5)), 0, 1) ** 1.5
    lean = left - right
    return {
        **leg("L", 24, 30, 4),
        **leg("R", -14, 24, -8),
        **arm(body, "L", 20, 22 + 62 * left, 8 + 10 * left, 112 - 100 * left),
        **arm(body, "R", 20, 18 + 66 * right, 10 + 12 * right, 116 - 104 * right),
        **fist("L", 60),
        **fist("R", 60),
        "spine03": turn("z", -16 * lean) @ turn("x", 6),
        "neck01": turn("z", 12 * lean) @ turn("x", 4),
    }


def turn_and_wave(body: Body, seconds: float) -> dict[str, Array]:
    """Turns about the upright axis with one arm overhead and the other passing the waist."""
    phase = 2 * np.pi * seconds / 1.6
    s, c = np.sin(phase), np.cos(phase)
    return {
        "root": turn("z", 34 * s),
        **leg("L", 10 + 10 * s, 16),
        **leg("R", 4 - 10 * s, 12 + 6 * c),
        **arm(body, "L", -62 - 14 * s, 14, 0, 38 + 20 * c),
        **arm(body, "R", 26, 22 + 10 * s, 34 + 26 * c, 74),
        "spine03": turn("y", 8 * c) @ turn("z", 12 * s),
        "neck01": turn("z", -24 * s),
        "head": turn("y", -6 * c),
    }


def greet(body: Body, seconds: float) -> dict[str, Array]:
    """One hand on the chest, the other open at the side, still."""
    return {
        **leg("L", 6, 8),
        **leg("R", -4, 6),
        **arm(body, "L", 18, 16, 2, 34),
        **arm(body, "R", 24, 18, 60, 96),
        "neck01": turn("z", -10) @ turn("x", 5),
    }
