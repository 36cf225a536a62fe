"""LinuxCNC screw compensation (COMP_FILE, type 0): the positioning error of each joint.

A line holds the nominal position and the positions truly reached going forward and in reverse; the loader keeps
nominal minus reached and adds it to the commanded motor position (ini-config manual; motion/usrmotintf). It stops in
silence at the first line that is not three numbers, so the file has no header: the text file beside it says the sign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.errors import InputError
from metrocli.exports.compensation import Control, Texts, files_of
from metrocli.exports.error_tables import AXES, Array, Curve, ErrorTables
from metrocli.result import Result

MOST_POINTS = 256
"""Triplets that the loader takes for a joint"""
_NOTE = "linuxcnc.txt"


def carried(tables: ErrorTables) -> ErrorTables:
    """Return the positioning errors."""
    return tables.only(tuple(f"E{axis}{axis}" for axis in AXES))


def written(tables: ErrorTables) -> Texts:
    """Return one file for each axis, and the note with the lines for the INI file."""
    texts = {}
    for name, curve in tables.curves.items():
        if len(curve.positions) > MOST_POINTS:
            raise InputError(f"{name} has {len(curve.positions)} points; LinuxCNC takes at most {MOST_POINTS} a joint")
        reached, half = curve.positions + curve.values, tables.reversal.get(name[2], 0.0) / 2
        rows = [f"{at:.6f} {to + half:.7f} {to - half:.7f}" for at, to in zip(curve.positions, reached, strict=True)]
        texts[f"{name[2].lower()}.comp"] = "\n".join([*rows, ""])
    if not texts:
        raise InputError("the result determines no positioning error: nothing for COMP_FILE")
    lines = [f"[JOINT_{AXES.index(name[0].upper())}] COMP_FILE = {name}, COMP_FILE_TYPE = 0" for name in texts]
    note = [
        *replace(tables, reversal={}).notes(),
        "each line of a .comp file: nominal, reached going forward, reached in reverse, in mm",
        "BACKLASH of the joint is ignored where a COMP_FILE is set: what the result has of it is in the two columns",
        *lines,
    ]
    return {**texts, _NOTE: "\n".join([*note, ""])}


def read(texts: Texts) -> dict[str, tuple[Curve, Curve]]:
    """Return the trims of each joint, forward and reverse, as the loader keeps them: up to the first other line."""
    held = {}
    for name, text in texts.items():
        if name == _NOTE:
            continue
        rows = []
        for line in text.splitlines():
            try:
                at, forward, reverse = map(float, line.split())
            except ValueError:
                break
            rows.append((at, at - forward, at - reverse))
        grid = np.array(rows)
        held[name[0].upper()] = Curve(grid[:, 0], grid[:, 1]), Curve(grid[:, 0], grid[:, 2])
    return held


def moved(held: Mapping[str, tuple[Curve, Curve]], commanded: Array) -> Array:
    """Return how the control moves the machine, in the mean of both directions: by the trims."""
    moves = np.zeros(commanded.shape)
    for axis, trims in held.items():
        k = AXES.index(axis)
        moves[:, k] = sum(trim.at(commanded[:, k]) for trim in trims) / 2
    return moves


CONTROL = Control(carried, written, read, moved, resolution=1e-6)


def files(result: Result) -> Texts:
    """Return the files of a result."""
    return files_of(CONTROL, result)
