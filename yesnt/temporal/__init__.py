"""Temporal regularisation of materials: flow, energy, solver (docs/method.md section 4)."""

from yesnt.temporal.blocks import (
    BlockLists,
    Border,
    band_rows,
    block_bytes,
    border_mask,
    halo_frames,
    halo_rows,
    largest_change,
    solve_block,
    solve_lists,
    sweeps_needed,
    vertical_reach,
)
from yesnt.temporal.bridging import bridged_links, solve_bridged
from yesnt.temporal.flow import FlowSettings, flow_and_validity, flow_validity
from yesnt.temporal.outliers import (
    OUTLIER_HALO,
    OutlierReport,
    OutlierSettings,
    consistent_members,
    robust_confidence,
)
from yesnt.temporal.params import EnergyParams, Solution, SolveStats
from yesnt.temporal.solver import energy, solve

__all__ = [
    "OUTLIER_HALO",
    "BlockLists",
    "Border",
    "EnergyParams",
    "FlowSettings",
    "OutlierReport",
    "OutlierSettings",
    "Solution",
    "SolveStats",
    "band_rows",
    "block_bytes",
    "border_mask",
    "bridged_links",
    "consistent_members",
    "energy",
    "flow_and_validity",
    "flow_validity",
    "halo_frames",
    "halo_rows",
    "largest_change",
    "robust_confidence",
    "solve",
    "solve_block",
    "solve_bridged",
    "solve_lists",
    "sweeps_needed",
    "vertical_reach",
]
