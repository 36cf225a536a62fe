"""What no residual of a measurement can show: settings and causes that the unknowns absorb."""

from __future__ import annotations

from collections.abc import Iterable

from metrocli import units
from metrocli.frozen import dataclass
from metrocli.table import Table

TABLE = "not_controlled"
"""Name of the table in results and plans"""
SCALE, SCALE_WORDS = units.parse_quantity("10 ppm", "ratio"), "10 um/m"
"""Scale error of a machine or of a list of places that is assumed: about 1 K of steel"""
AIR, AIR_WORDS = units.parse_quantity("0.96 ppm", "ratio"), "1 K of air temperature (0.96 um/m)"
ASSUMED = "air that the instrument assumes (`environment: assumed`), common to all lengths"
ASSUMED_CONTROL = "the settings of the instrument, or a known length; the uncertainty of the true air is in the result"


@dataclass(frozen=True)
class Hidden:
    """A cause that leaves no residual."""

    effect: str
    """What may be wrong, and in brackets what it changes"""
    assumed: str
    """A plausible size of the cause"""
    hides: float
    """Error of the result from it [mm], proportional to it"""
    control: str
    """What would control it"""


def table_of(hidden: Iterable[Hidden]) -> Table:
    """Return the table `not_controlled`: effect, assumed, hides [mm], control."""
    rows = [(quantity.effect, quantity.assumed, quantity.hides, quantity.control) for quantity in hidden]
    return Table.of_rows(("effect [text]", "assumed [text]", "hides [mm]", "control [text]"), rows)


def in_words(hidden: Table) -> tuple[str, ...]:
    """Return the lines of a summary of the table; empty if it has no row."""
    if not len(hidden):
        return ()
    rows = zip(*(hidden.texts(name) for name in ("effect", "assumed")), hidden.numbers("hides"), strict=True)
    lines = [f"  {effect}: {units.roughly(size, 'um')} by {assumed}" for effect, assumed, size in rows]
    return ("", f"not controlled by this design (table {TABLE} lists what would control it):", *lines)
