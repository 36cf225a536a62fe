"""ISG_CSV, the volumetric compensation of ISG kernels and Beckhoff TF5280: all tables and squareness.

Blanks separate the columns, a header names argument and errors, `//` starts a comment and `#` a new block; units are mm
and rad (ISG documentation, file formats of the volumetric compensation). The control's own settings hold the kinematic
chain with its workpiece axes, and a switch `negate` for values that are errors instead of corrections.
"""

from __future__ import annotations

import numpy as np

from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts
from metrocli.exports.error_tables import AXES, ErrorTable, ErrorTables
from metrocli.exports.volumetric import ReadErrors, chain_note, moved_by_errors, trial_move

_FILE = "errors.isg.csv"


def written(tables: ErrorTables) -> Texts:
    """Return the file; raises InputError if no error table is determined."""
    if not tables.curves:
        raise InputError("the result determines no error table: nothing to compensate")
    blocks = [_block(tables, axis) for axis in AXES if _names(tables, axis)]
    if tables.squareness:
        names = list(tables.squareness)
        blocks.append([" ".join(names), " ".join(f"{tables.squareness[name]:.12f}" for name in names)])
    lines = ["\n".join(block) for block in blocks]
    head = "\n".join(f"// {line}" for line in [*tables.notes(), *chain_note(tables), *trial_move(tables)])
    return {_FILE: head + "\n" + "\n#\n".join(lines) + "\n"}


def _names(tables: ErrorTables, axis: str) -> list[str]:
    return [name for name in tables.curves if name[2] == axis]


def _block(tables: ErrorTables, axis: str) -> list[str]:
    names = _names(tables, axis)
    grid = np.unique(np.concatenate([tables.curves[name].positions for name in names]))
    columns = [tables.curves[name].at(grid) for name in names]
    rows = [" ".join([f"{at:.6f}", *(f"{column[k]:.12f}" for column in columns)]) for k, at in enumerate(grid.tolist())]
    return [" ".join([axis, *names]), *rows]


def read(texts: Texts) -> ReadErrors:
    """Return the curves, the squareness errors and the comments of the file."""
    lines = texts[_FILE].splitlines()
    comments = [line for line in lines if line.startswith("//")]
    body = "\n".join(line for line in lines if not line.startswith("//"))
    curves: dict[str, ErrorTable] = {}
    squareness: dict[str, float] = {}
    for block in body.split("#"):
        names, *rows = [line.split() for line in block.strip().splitlines()]
        values = np.array(rows, dtype=float)
        if names[0] in AXES:
            curves |= {name: ErrorTable(values[:, 0], values[:, k]) for k, name in enumerate(names) if k}
        else:
            squareness |= dict(zip(names, values[0].tolist(), strict=True))
    return curves, squareness, comments


CONTROL = CompensationFormat(written, read, moved_by_errors, resolution=1e-6)
