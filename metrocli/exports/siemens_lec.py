"""Siemens leadscrew error compensation ($AA_ENC_COMP): the positioning error of each axis.

The control adds the value to the actual position, so a positive value moves the axis in its negative direction.
Therefore the value is the error itself (SINUMERIK 808D manual, p. 106; syntax: function manual 6FC5397-1BP40, K3).
Tables of rotary axes are in degrees; with the modulo function one of 0 to 360 deg repeats (808D manual, p. 109).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts, positioning, sign_test
from metrocli.exports.error_tables import LETTERS, ErrorTable, ErrorTables, unit_of
from metrocli.exports.volumetric import evenly

MOST_POINTS = 5000
"""Upper limit of MD38000; an 808D takes at most 200"""
_VALUE = re.compile(r"\$AA_ENC_COMP\[0,(\d+),(\w)1\]=(\S+)")
_SETTING = re.compile(r"\$AA_ENC_COMP_(STEP|MIN|MAX)\[0,(\w)1\]=(\S+)")


def written(tables: ErrorTables) -> Texts:
    """Return one file for each axis; raises InputError if there is no positioning error or no grid for it."""
    texts = {}
    for name, curve in tables.curves.items():
        axis = name[2]
        even = evenly(curve, MOST_POINTS)
        if even is None:
            raise InputError(
                f"no even grid of {MOST_POINTS} points, the most that $AA_ENC_COMP takes, contains all knots of {name}"
            )
        texts[f"{axis}_EEC.INI"] = _text(axis, even, tables)
    if not texts:
        raise InputError("the result determines no positioning error: nothing for leadscrew error compensation")
    return texts


def _text(axis: str, curve: ErrorTable, tables: ErrorTables) -> str:
    count = len(curve.positions)
    step = (curve.positions[-1] - curve.positions[0]) / max(count - 1, 1)
    head = [
        f"%_N_{axis}_EEC_INI",
        *(f"; {line}" for line in tables.notes()),
        f"; {sign_test(axis, curve)}",
        f"; value = E{axis}{axis} in {unit_of(axis)}, which the control adds to the actual position",
        f"; needs MD38000 $MA_MM_ENC_COMP_MAX_POINTS >= {count}; load while MD32700 = 0, then reference the axis",
        "; SINUMERIK 808D takes at most 200 points",
        "CHANDATA(1)",
    ]
    values = [f"$AA_ENC_COMP[0,{k},{axis}1]={value:.6f}" for k, value in enumerate(curve.values)]
    tail = [
        f"$AA_ENC_COMP_STEP[0,{axis}1]={step:.9f}",
        f"$AA_ENC_COMP_MIN[0,{axis}1]={curve.positions[0]:.6f}",
        f"$AA_ENC_COMP_MAX[0,{axis}1]={curve.positions[-1]:.6f}",
        f"$AA_ENC_COMP_IS_MODULO[0,{axis}1]={int(axis in tables.periodic)}",
        "M17",
    ]
    return "\n".join([*head, *values, *tail, ""])


def read(texts: Texts) -> dict[str, ErrorTable]:
    """Return the table of each axis as the control stores it."""
    curves = {}
    for text in texts.values():
        values = {int(k): float(value) for k, _, value in _VALUE.findall(text)}
        settings = {key: float(value) for key, _, value in _SETTING.findall(text)}
        axis = _VALUE.findall(text)[0][1]
        grid = settings["MIN"] + settings["STEP"] * np.arange(float(len(values)))
        curves[axis] = ErrorTable(grid, np.array([values[k] for k in range(len(values))]))
    return curves


def moved(held: Mapping[str, ErrorTable], commanded: Array) -> Array:
    """Return the movement (n, axes) by the control: the negative value of the table."""
    moves = np.zeros(commanded.shape)
    for axis, curve in held.items():
        k = LETTERS.index(axis)
        moves[:, k] = -curve.at(commanded[:, k])
    return moves


CONTROL = CompensationFormat(written, read, moved, resolution=1e-6, carried=positioning, turns=True)
