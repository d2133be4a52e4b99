"""Seamless greyscale textures from which materials are painted: noise, weaves, strands, grain."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

SIZE = 256
"""Side of a tile in texels."""

CYCLES = 16
"""Repeats of a regular pattern (threads, stripes, pores) along one side of a tile."""

NAMES = (
    "plain", "cloudy", "mottled", "gritty", "weave", "twill", "knit", "strands", "grain", "pores", "streaks",
    "stripes", "checks", "dots", "blotches", "hammered", "chequers",
)  # fmt: skip
"""Names of the tiles in the order of `tile_bank`."""


def tile_index(name: str) -> int:
    """Returns the index of a tile in the bank."""
    return NAMES.index(name)


@cache
def tile_bank() -> Float32:
    """Returns all tiles [len(NAMES), SIZE, SIZE], each with mean 0 and a range of about [-1, 1]."""
    rng = np.random.default_rng(20)
    y, x = np.mgrid[0:SIZE, 0:SIZE] * (2 * np.pi * CYCLES / SIZE)
    cloudy, mottled, gritty = (_spectral(rng, power, (1, 1)) for power in (1.8, 1.2, 0.4))
    streaks = _spectral(rng, 0.6, (24, 1))
    strands = 0.7 * _spectral(rng, 0.7, (30, 1)) + 0.3 * np.sin(x + 2 * cloudy)
    tiles = {
        "plain": np.zeros((SIZE, SIZE)),
        "cloudy": cloudy,
        "mottled": mottled,
        "gritty": gritty,
        "weave": _weave(x, y),
        "twill": np.sin(x + y) + 0.3 * gritty,
        "knit": np.abs(np.sin(x / 2)) * np.cos(y + 3 * np.abs(np.sin(x / 2))),
        "strands": strands,
        "grain": np.sin(x / 2 + 5 * cloudy) + 0.5 * streaks,
        "pores": _cells(rng),
        "streaks": streaks,
        "stripes": np.sign(np.sin(x / 2)),
        "checks": np.sign(np.sin(x / 2)) + np.sign(np.sin(y / 2)),
        "dots": np.where(np.sin(x / 2) * np.sin(y / 2) > 0.5, 1.0, -0.3),
        "blotches": np.clip(4 * cloudy, -1, 1),
        "hammered": _cells(rng) ** 2,
        "chequers": np.sign(np.sin(x / 2)) * np.sign(np.sin(y / 2)),
    }
    return np.stack([_centred(tiles[name]) for name in NAMES]).astype(np.float32)


def _centred(tile: NDArray[np.float64]) -> NDArray[np.float64]:
    tile = tile - tile.mean()
    return tile / max(1e-6, 2 * float(tile.std())) if tile.any() else tile


def _spectral(rng: np.random.Generator, power: float, stretch: tuple[int, int]) -> NDArray[np.float64]:
    """Periodic noise with amplitude ~ frequency^-power; `stretch` elongates it in y or in x."""
    fy, fx = np.fft.fftfreq(SIZE)[:, None] * stretch[0], np.fft.rfftfreq(SIZE)[None, :] * stretch[1]
    radius = np.maximum(np.hypot(fy, fx), 1 / SIZE)
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * radius**-power
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, s=(SIZE, SIZE))
    return noise / (2 * noise.std())


def _weave(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Plain weave: warp and weft alternate from thread to thread."""
    over = np.sin(x / 2) * np.sin(y / 2) > 0
    return np.where(over, np.abs(np.sin(x / 2)) * 0.5 + 0.5, np.abs(np.sin(y / 2)) * 0.5)


def _cells(rng: np.random.Generator) -> NDArray[np.float64]:
    """Distance to the nearest of random points, periodic."""
    points = rng.random((CYCLES * CYCLES, 2)) * SIZE
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    nearest = np.full((SIZE, SIZE), np.inf)
    for py, px in points:
        dy, dx = np.abs(y - py), np.abs(x - px)
        np.minimum(nearest, np.hypot(np.minimum(dy, SIZE - dy), np.minimum(dx, SIZE - dx)), out=nearest)
    return nearest
