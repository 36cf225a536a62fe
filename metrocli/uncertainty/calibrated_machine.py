"""A machine with its error tables, read from a result of calibrate-machine, and its error motion where it is sent."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.instruments.axes.error_motion import by_errors, by_squareness
from metrocli.instruments.machine import (
    AXES,
    SQUARENESS_NAMES,
    Axis,
    Machine,
    bracket,
    errors_of,
)
from metrocli.result import Result
from metrocli.table import Table
from metrocli.uncertainty.comparison import ENTRIES, TABLES, TABLES_COVARIANCE

_ALL = slice(None)
_SLACK = 1e-6
"""A commanded position beyond the range of an axis by less than this is rounding [mm]"""


def has_machine(result: Result) -> bool:
    """Return whether a result has error tables with their covariance."""
    return TABLES_COVARIANCE in result.arrays


def digest_of(result: Result) -> str:
    """Return a digest of the entries of all tables and their covariance: equal for results of the same calibration."""
    parts = (_values(result), result.arrays[TABLES_COVARIANCE])
    return sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def error_motion(result: Result, position: Array, tool: Array) -> tuple[Array, Array]:
    """Return displacement and rotation (d, theta) of tools at commanded positions, (n, 6), by a result's 21 errors.

    Positions are (3, n), tool vectors (3, n) or (3, 1). With it come the derivatives by the entries of all tables,
    (n, 6, entries), in the order of the covariance of the tables. Tables that are not determined count as zero.
    """
    by_entry = _by_entry(result.tables[ENTRIES], _machine(result), position, tool)
    return by_entry @ _values(result), by_entry


def outside(result: Result, commanded: Table, key: str = "point", rows: Index | slice = _ALL) -> list[Fault]:
    """Return a fault for each position beyond the calibrated range of an axis; `key` is the column of their names."""
    faults: list[Fault] = []
    whose = [f" of {key} '{text}'" for text in commanded.texts(key)] if key in commanded else [""] * len(commanded)
    chosen = np.arange(len(commanded))[rows]
    for axis in _machine(result).axes:
        name, low, high = axis.key, float(axis.knots[0]), float(axis.knots[-1])
        at = commanded.numbers(name)
        beyond = (at < low - _SLACK) | (at > high + _SLACK)
        hint = f"expected {low:g} to {high:g} mm: leave the {key} out"
        faults += commanded.faults_at(
            chosen[beyond[chosen]].tolist(),
            lambda row, at=at, name=name: (  # type: ignore[misc]
                f"the commanded {name} {at[row]:g} mm{whose[row]} is outside the calibrated axis"
            ),
            lambda _, hint=hint: hint,  # type: ignore[misc]
        )
    return faults


def _machine(result: Result) -> Machine:
    """Return the machine of a result; raises InputError for rotary axes, whose motion is not a sum of tables."""
    if "rotary_axes" in result.tables:
        raise InputError("a machine with rotary axes: only machines with three linear axes are predicted here")
    axes, entries = result.tables["axes"], result.tables[ENTRIES]
    place = axes.numbers("place")
    error, position = np.array(entries.texts("error")), entries.numbers("position")
    x, y, z = (Axis(letter, position[error == f"E{letter}{letter}"]) for letter in AXES)
    return Machine(tuple(np.argsort(place).tolist()), (x, y, z))


def _values(result: Result) -> Array:
    """Return the entries of all tables; those without a value in the result are zero."""
    listed, square = result.tables[ENTRIES], {estimate.name: estimate.value for estimate in result.estimates}
    error, position = np.array(listed.texts("error")), listed.numbers("position")
    values = np.array([square.get(name, 0.0) for name in error.tolist()])
    for name in np.unique(error[~np.isnan(position)]).tolist():
        if TABLES + name in result.tables:
            values[error == name] = np.nan_to_num(result.tables[TABLES + name].numbers("value"), nan=0.0)
    return values


def _by_entry(entries: Table, machine: Machine, position: Array, tool: Array) -> Array:
    """Return the derivatives of (d, theta) by the entries of all tables, (n, 6, entries)."""
    error, n = np.array(entries.texts("error")), position.shape[1]
    derivative, rows = np.zeros((n, 6, len(error))), np.arange(n)
    for axis in machine.axes:
        lower, share = bracket(axis.knots, position[axis.number])
        by_error = by_errors(machine.lever(axis.number, position, tool))
        for k, name in enumerate(errors_of(axis.letter)):
            columns = np.flatnonzero(error == name)
            derivative[rows, :, columns[lower]] = (by_error[:, k] * (1 - share)).T
            derivative[rows, :, columns[lower + 1]] = (by_error[:, k] * share).T
    # squareness acts on the position alone: a tool vector takes no part in it, so 0 stands in its place
    by_angle = next(iter(by_squareness(position, np.zeros(3))[1].values()))
    for k, name in enumerate(SQUARENESS_NAMES):
        derivative[:, :, error == name] = by_angle[:, k].T[:, :, None]
    return derivative
