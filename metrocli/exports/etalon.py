"""Etalon exchange format, `Vendor` variant: one block for each error (ISG documentation, volumetric compensation)."""

from __future__ import annotations

import re

import numpy as np

from metrocli.errors import InputError
from metrocli.exports.compensation import Control, Texts, files_of
from metrocli.exports.error_tables import Array, Curve, ErrorTables
from metrocli.exports.volumetric import chain_note, moved_by_errors, trial_move
from metrocli.result import Result

_FILE = "errors.etalon.txt"
_BLOCK = re.compile(r"\[(\w+)\]\s*Gridpoints = \{([^}]*)\}")
_SINGLE = re.compile(r"\[(\w+)\]\s*VALUE = (\S+)")


def carried(tables: ErrorTables) -> ErrorTables:
    """Return all errors: the format holds everything."""
    return tables


def written(tables: ErrorTables) -> Texts:
    """Return the file; raises InputError if no error table is determined."""
    if not tables.curves:
        raise InputError("the result determines no error table: nothing to compensate")
    head = [f"// {line}" for line in [*tables.notes(), *chain_note(tables), *trial_move(tables)]]
    blocks = [_block(name, curve) for name, curve in tables.curves.items()]
    single = [f"[{name}]\nVALUE = {value:.12f}" for name, value in tables.squareness.items()]
    return {_FILE: "\n".join([*head, *blocks, *single, ""])}


def _block(name: str, curve: Curve) -> str:
    rows = [f"  {at:.6f} {value:.12f}" for at, value in zip(curve.positions, curve.values, strict=True)]
    return "\n".join([f"[{name}]", "Gridpoints = {", *rows, f"}} // end of {name}"])


def read(texts: Texts) -> tuple[dict[str, Curve], dict[str, float], list[str]]:
    """Return the curves, the squareness errors and the comments of the file."""
    text = texts[_FILE]
    curves = {}
    for name, rows in _BLOCK.findall(text):
        values = np.array([row.split() for row in rows.strip().splitlines()], dtype=float)
        curves[name] = Curve(values[:, 0], values[:, 1])
    squareness = {name: float(value) for name, value in _SINGLE.findall(text)}
    return curves, squareness, [line for line in text.splitlines() if line.startswith("//")]


def moved(held: tuple[dict[str, Curve], dict[str, float], list[str]], commanded: Array) -> Array:
    """Return the movement (n, 3) mm by the control: the negative error of the rigid-body model."""
    return moved_by_errors(*held, commanded)


CONTROL = Control(carried, written, read, moved, resolution=1e-6)


def files(result: Result) -> Texts:
    """Return the files of a result."""
    return files_of(CONTROL, result)
