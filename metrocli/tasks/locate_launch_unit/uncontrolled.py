"""Errors that no residual of a location can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Array
from metrocli.table import Table
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of

_OFFSET = units.parse_quantity("10 um", "length")


def uncontrolled(receiver: Array, place: Array) -> Table:
    """Return what the place of the unit absorbs; `receiver` (n, 3) mm, `place` (3,) mm in the machine."""
    return table_of(_rows(receiver, place))


def _rows(receiver: Array, place: Array) -> Iterator[Hidden]:
    yield Hidden(
        "common scale of machine and distances (place of the unit, seen from the poses)",
        SCALE_WORDS,
        SCALE * float(np.linalg.norm(receiver - place, axis=1).max()),
        "temperature of the machine; a calibrated distance",
    )
    yield Hidden(
        "control point of the receiver along the spindle (place of the unit)",
        "10 um",
        _OFFSET,
        "the length of the receiver measured; it moves all poses alike",
    )
