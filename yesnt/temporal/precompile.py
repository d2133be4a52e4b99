"""Compiles the kernels of the temporal stage by solving a tiny problem with the types that the tasks use."""

from __future__ import annotations

import numpy as np

from yesnt.temporal.blocks import BlockLists, solve_lists
from yesnt.temporal.geometry import PackedMasks, build_geometry
from yesnt.temporal.params import EnergyParams


def precompile_solver() -> None:
    """All kernels: pixel lists and stencils, the energy, float32 linear systems, the certificate."""
    solve_lists(_tiny_lists(), EnergyParams(), 1e-3)


def _tiny_lists() -> BlockLists:
    """Two frames of 3 x 3 pixels with random values."""
    generator = np.random.default_rng(0)
    masks = PackedMasks((2, 3, 3))
    for t in range(2):
        masks[t] = np.ones((3, 3), bool)
    flow, validity = np.zeros((1, 2, 3, 3), np.float32).transpose(0, 2, 3, 1), np.ones((1, 3, 3), np.float32)
    geometry = build_geometry(masks, flow, validity)
    observed = generator.random((2, geometry.pixels), np.float32)
    return BlockLists(geometry, observed, np.ones_like(observed), observed)
