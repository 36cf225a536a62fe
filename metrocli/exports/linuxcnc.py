"""LinuxCNC screw compensation (COMP_FILE, type 0): the positioning error of each joint.

A line holds the nominal position and the positions actually reached in forward and in reverse travel. The loader stores
nominal minus reached and adds it to the commanded motor position (ini-config manual; motion/usrmotintf). It stops
without a message at the first line that is not three numbers. Therefore the files have no header, and a text file
beside them documents the sign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts, positioning, sign_test
from metrocli.exports.error_tables import LETTERS, ErrorTable, ErrorTables

MOST_POINTS = 256
"""Most triplets that the loader accepts per joint"""
_NOTE = "linuxcnc.txt"
_ONE_TURN = (
    "the table of an axis that takes any turn goes from 0 to 360 deg; LinuxCNC does not repeat it: keep the joint "
    "within this turn. A joint has the number of its letter among XYZABC: change it if yours differ"
)


def written(tables: ErrorTables) -> Texts:
    """Return one file for each axis, and a note with the lines for the INI file.

    Raises InputError if there is no positioning error, or if a table is too long.
    """
    texts = {}
    for name, curve in tables.curves.items():
        if len(curve.positions) > MOST_POINTS:
            raise InputError(
                f"{name} has {len(curve.positions)} points; LinuxCNC takes at most {MOST_POINTS} per joint"
            )
        reached, half = curve.positions + curve.values, tables.reversal.get(name[2], 0.0) / 2
        rows = [f"{at:.6f} {to + half:.7f} {to - half:.7f}" for at, to in zip(curve.positions, reached, strict=True)]
        texts[f"{name[2].lower()}.comp"] = "\n".join([*rows, ""])
    if not texts:
        raise InputError("the result determines no positioning error: nothing for COMP_FILE")
    lines = [f"[JOINT_{LETTERS.index(name[0].upper())}] COMP_FILE = {name}, COMP_FILE_TYPE = 0" for name in texts]
    note = [
        *replace(tables, reversal={}).notes(),
        "each line of a .comp file: nominal position, position reached in forward travel, in reverse travel; mm or deg",
        *(sign_test(name[2], curve) for name, curve in tables.curves.items()),
        *([_ONE_TURN] if tables.periodic else []),
        "LinuxCNC ignores BACKLASH of a joint with a COMP_FILE: the two columns contain the backlash of the result",
        *lines,
    ]
    return {**texts, _NOTE: "\n".join([*note, ""])}


def read(texts: Texts) -> dict[str, tuple[ErrorTable, ErrorTable]]:
    """Return the stored trims of each joint, forward and reverse; like the loader, stop at the first invalid line."""
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
        held[name[0].upper()] = ErrorTable(grid[:, 0], grid[:, 1]), ErrorTable(grid[:, 0], grid[:, 2])
    return held


def moved(held: Mapping[str, tuple[ErrorTable, ErrorTable]], commanded: Array) -> Array:
    """Return the movement (n, axes) by the control, the mean of both directions: the trims are added."""
    moves = np.zeros(commanded.shape)
    for axis, trims in held.items():
        k = LETTERS.index(axis)
        moves[:, k] = sum(trim.at(commanded[:, k]) for trim in trims) / 2
    return moves


CONTROL = CompensationFormat(written, read, moved, resolution=1e-6, carried=positioning, turns=True)
