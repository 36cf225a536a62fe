"""Results over the volume: errors of each tool on a grid, what remains after compensation, and body diagonals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.machine import TOOL, Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.contours import circular, diagonals
from metrocli.tasks.calibrate_machine.acceptance.ranges import draws
from metrocli.tasks.calibrate_machine.machine_settings import VolumeGrid
from metrocli.tasks.calibrate_machine.rank.identifiability import Identifiability
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.calibrate_machine.volume import ToolErrors, grid_of, predict, tips, without_rigid_motion

NOT_CONTAINED = (
    "volumetric: errors without shift and rotation of the whole, and the standard uncertainty of their vectors (RMS). "
    "It is that of the estimated tables alone: the machine's repeatability and its errors between knots add to it"
)
"""What the reader of /volumetric has to know of its uncertainty"""


def volume_tables(
    tables: Tables, identified: Identifiability, wanted: VolumeGrid, measured: Sequence[str]
) -> dict[str, Table]:
    """Return the error of each tool on a grid, and the diagonal and circular tests of the first tool."""
    position = grid_of(tables.machine, wanted.counts(len(tables.machine.axes)))
    tools = tables.blocks[TOOL].members[: len(tables.machine.tools)]
    grids = [_on_grid(tables, position, i, name in identified.open_tools) for i, name in enumerate(tools)]
    shown = {
        "volumetric": _summary(grids, tools, measured),
        "volume": Table.stack([grid.table(tools[i], tables.machine) for i, grid in enumerate(grids)]),
    }
    if tables.machine.turns:
        return shown
    first = tools.index(measured[0])
    drawn = draws(tables.raw)
    along, figures = diagonals(tables, drawn, first)
    return {
        **shown,
        "diagonals": along,
        "diagonal_figures": figures,
        "circular": circular(tables, drawn, first, wanted.circle),
    }


@dataclass(frozen=True)
class _OnGrid:
    position: Array
    prediction: ToolErrors
    shape: Array
    """Length of the error after the best shift and turn (n,)"""
    left: float
    """Standard uncertainty of the error vector: root mean square over the grid, after the best shift and turn"""
    is_open: bool

    def table(self, tool: str, machine: Machine) -> Table:
        n = self.position.shape[1]
        std = np.full((3, n), np.inf) if self.is_open else self.prediction.std
        error = np.full((3, n), np.nan) if self.is_open else self.prediction.error
        errors = {"ex ey ez [mm]": error.T, "s_ex s_ey s_ez [mm]": std.T}
        tools = np.repeat(np.array([tool], dtype=str), n)
        return Table.of({"tool": tools, **machine.columns(self.position), **errors})


def _on_grid(tables: Tables, position: Array, tool: int, is_open: bool) -> _OnGrid:
    prediction, design = predict(tables.machine, tables.blocks, (tables.unknowns, tables.raw), position, tool)
    at = tips(tables.machine, position, tool)
    shape = np.linalg.norm(without_rigid_motion(prediction.error, at), axis=0)
    free = without_rigid_motion(design, at).reshape(-1, tables.unknowns.size)
    left = float(np.sqrt(max(np.einsum("ij,jk,ik->", free, tables.raw, free, optimize=True), 0.0) / position.shape[1]))
    return _OnGrid(position, prediction, shape, left, is_open)


def _summary(grids: Sequence[_OnGrid], tools: Sequence[str], measured: Sequence[str]) -> Table:
    """Return for each tool its error in the volume, and the uncertainty that remains after compensation.

    All after the best shift and turn of the volume; nan and inf if the error of the tool cannot be predicted.
    """
    unknown = np.array([grid.is_open for grid in grids])
    mean = np.array([grid.shape.mean() for grid in grids])
    largest = np.array([grid.shape.max() for grid in grids])
    return Table.of(
        {
            "tool": [name or "tool" for name in tools],
            "measured": [name in measured for name in tools],
            "mean_error [mm]": np.where(unknown, np.nan, mean),
            "largest_error [mm]": np.where(unknown, np.nan, largest),
            "uncertainty [mm]": np.where(unknown, np.inf, np.array([grid.left for grid in grids])),
        }
    )
