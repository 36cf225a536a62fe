"""What every compensation format promises: read back and applied as the control does, it leaves only its rounding."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrocli.exports.error_tables import AXES, Array, ErrorTables, of

Texts = Mapping[str, str]
"""Files of a format: text by name"""


@dataclass(frozen=True)
class Control:
    """One format, with a small model of the control that reads it."""

    carried: Callable[[ErrorTables], ErrorTables]
    """The errors that the format can hold"""
    written: Callable[[ErrorTables], Texts]
    """The files; raises InputError where a limit of the control is exceeded"""
    read: Callable[[Texts], Any]
    """The tables as the control holds them"""
    moved: Callable[[Any, Array], Array]
    """By how much the control moves the machine (n, 3) at commanded positions (n, 3), mm"""
    resolution: float
    """Largest rounding of a written error, mm"""
    coarsened: Callable[[Any], float] = lambda held: 1.0
    """By how much the tables as the control holds them are coarser than that"""

    def files(self, tables: ErrorTables) -> Texts:
        """Return the files, proven on the model of the control.

        Raises AssertionError where reading them back and applying them leaves more than the rounding, which would be
        a defect: a wrong sign would double the error.
        """
        carried = self.carried(tables)
        texts = self.written(carried)
        left, promised = self.left(carried, texts), self.promised(texts)
        if left > promised:
            raise AssertionError(f"the compensation leaves {left:.2g} mm where {promised:.2g} mm was promised")
        return texts

    def promised(self, texts: Texts) -> float:
        """Return the largest error (mm) that the rounding in the files may leave."""
        return self.resolution * self.coarsened(self.read(texts))

    def left(self, carried: ErrorTables, texts: Texts) -> float:
        """Return the largest error (mm) that is left when the control applies the files."""
        places = places_of(carried)
        return float(np.abs(carried.at(places) + self.moved(self.read(texts), places)).max())


def places_of(tables: ErrorTables) -> Array:
    """Return positions (n, 3) mm at, between and beside the knots of all axes."""
    per_axis = []
    for axis in AXES:
        ends = tables.span(axis)
        per_axis.append(ends[0] + (ends[1] - ends[0]) * np.array([0.0, 0.137, 0.25, 0.5, 0.781, 1.0]))
    lattice = np.array(list(itertools.product(*per_axis)))
    lines = [_along(tables, k) for k in range(len(AXES))]
    return np.concatenate([lattice, *lines])


def _along(tables: ErrorTables, axis: int) -> Array:
    """Return all knots of an axis and the middles between them, the other axes where they start."""
    found = [curve.positions for name, curve in tables.curves.items() if name[2] == AXES[axis]]
    knots = np.unique(np.concatenate(found)) if found else np.zeros(1)
    where = np.concatenate([knots, (knots[1:] + knots[:-1]) / 2])
    places = np.tile([tables.span(name)[0] for name in AXES], (len(where), 1))
    places[:, axis] = where
    return places


def files_of(control: Control, result: Any) -> Texts:
    """Return the files of a result in a format; raises InputError where the result has no error tables."""
    return control.files(of(result))
