"""Circular and diagonal tests that the error tables predict (ISO 230-4, ISO 230-6).

The tables are quasi-static: what the drives do at a feed, and the reversal between the two senses, is not in them.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.ranges import Profile
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.calibrate_machine.volume import predict

DIAGONALS = {"PPP": (1, 1, 1), "NPP": (-1, 1, 1), "PNP": (1, -1, 1), "NNP": (-1, -1, 1)}
"""The body diagonals of ISO 230-6 by the direction of travel along X, Y, Z"""
PLANES = {"XY": (0, 1), "YZ": (1, 2), "ZX": (2, 0)}
_STEPS = 11
_AROUND = 360
"""Points of a circle"""
_SHARE = 0.4
"""Radius of a circle as a share of the shorter travel in its plane, unless the job gives one"""


def _profile(tables: Tables, drawn: Array, tool: int, position: Array, towards: Array) -> Profile:
    """Return the error of a tool at positions (3, n) along directions (3, n), with drawn errors of the unknowns."""
    prediction, design = predict(tables.machine, tables.blocks, (tables.unknowns, tables.raw), position, tool)
    values = np.einsum("an,an->n", towards, prediction.error)
    return Profile(values, np.einsum("an,anp->np", towards, design), drawn)


def diagonals(tables: Tables, drawn: Array, tool: int) -> tuple[Table, Table]:
    """Return the deviation along each body diagonal from its start with its standard uncertainty, and E of each with U.

    E is the systematic deviation of a diagonal, the range of its deviations (ISO 230-6:2002, which takes the figures of
    ISO 230-2 along the diagonals). `drawn` are errors of the unknowns (draws, unknowns).
    """
    low, high = tables.machine.low, tables.machine.high
    parts, figures = [], []
    for name, signs in DIAGONALS.items():
        start, end = np.where(np.array(signs) > 0, low, high), np.where(np.array(signs) > 0, high, low)
        share, length = np.linspace(0, 1, _STEPS), float(np.linalg.norm(end - start))
        position = start[:, None] + (end - start)[:, None] * share
        towards = np.repeat((end - start)[:, None] / length, _STEPS, axis=1)
        profile = _profile(tables, drawn, tool, position, towards)
        row = profile.rows - profile.rows[0]
        std = np.sqrt(np.maximum(np.einsum("np,pq,nq->n", row, tables.raw, row, optimize=True), 0.0))
        along = {"position [mm]": length * share, "deviation [mm]": profile.values - profile.values[0], "std [mm]": std}
        parts.append(Table.of({"diagonal": np.repeat(np.array([name]), _STEPS), **along}))
        figures.append((name, length, *profile.range_with_u()))
    return Table.stack(parts), Table.of_rows(("diagonal", "length [mm]", "E [mm]", "U_E [mm]"), figures)


def circular(tables: Tables, drawn: Array, tool: int, radius: float | None) -> Table:
    """Return the circular test in each plane through the middle of the volume (ISO 230-4:2005).

    G is the circular deviation: the range of the radial deviations about the least-squares circle. F_max and F_min are
    the extremes of the radial deviation from the nominal circle about the least-squares centre. A plane whose travel
    is too short for the radius is left out. `drawn` are errors of the unknowns (draws, unknowns).
    """
    low, high = tables.machine.low, tables.machine.high
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    figures = []
    for name, axes in PLANES.items():
        most = float((high - low)[list(axes)].min()) / 2
        own = 2 * _SHARE * most if radius is None else radius
        if own > most:
            continue
        towards = np.zeros((3, _AROUND))
        towards[axes[0]], towards[axes[1]] = np.cos(turn), np.sin(turn)
        profile = _profile(tables, drawn, tool, (low + high)[:, None] / 2 + own * towards, towards)
        # the centre of the least-squares circle of a small deviation is its first harmonic (ISO 12181-1)
        centre = np.column_stack([np.cos(turn), np.sin(turn)]) * np.sqrt(2 / _AROUND)
        left = Profile(
            profile.values - centre @ (centre.T @ profile.values),
            profile.rows - centre @ (centre.T @ profile.rows),
            drawn,
        )
        figures.append((name, own, *left.range_with_u(), float(left.values.max()), float(left.values.min())))
    headings = ("plane", "radius [mm]", "G [mm]", "U_G [mm]", "F_max [mm]", "F_min [mm]")
    return Table.of_rows(headings, figures)
