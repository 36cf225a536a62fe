"""Errors that no overstock of a raw part can show: it has no size of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.errors import NotConvergedError
from metrocli.table import Table
from metrocli.tasks.fit_part.fit import MOST, most_of_many
from metrocli.tasks.fit_part.solve import Solved, fitted_part
from metrocli.tasks.shared.part import taken_as_exact
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of

_STEEL = units.parse_quantity("11.5 ppm", "ratio")
"""Growth of steel by 1 K"""


def uncontrolled(solved: Solved) -> Table:
    """Return what the overstock absorbs, and its largest change by a plausible size of each."""
    return table_of(_rows(solved))


def _rows(solved: Solved) -> Iterator[Hidden]:
    part, per_scale = solved.prepared.part, by_scale(solved)
    yield Hidden(
        "common scale of the measured points (overstock of opposite surfaces)",
        SCALE_WORDS,
        SCALE * per_scale,
        "scale bars that are calibrated, and test lengths beside them",
    )
    if part is None:
        yield Hidden(
            "temperature of the raw part at its measurement (overstock of opposite surfaces)",
            "1 K of steel (11.5 um/m)",
            _STEEL * per_scale,
            "`part:` with temperature and expansion; the overstock holds at the temperature of the measurement",
        )
    yield from taken_as_exact(part, per_scale, "overstock of opposite surfaces")


def by_scale(solved: Solved) -> float:
    """Return the largest change of an overstock by a relative change of the scale of the points [mm].

    The part is fitted again to points that are larger about their middle; NaN where it then has no pose.
    """
    stock, begin = solved.stock, (solved.fit.into, np.inf, solved.fit.duals)
    middle = stock.measured.mean(axis=0)
    larger = replace(stock, measured=middle + (stock.measured - middle) * (1 + SCALE))
    if solved.aim.name == MOST:
        begin = most_of_many(larger, solved.fit.into)
    try:
        _, fitted = fitted_part(larger, solved.aim.name, solved.minimum, begin, solved.prepared.start)
    except NotConvergedError:
        return float("nan")
    return float(np.abs(fitted.local.overstock - solved.fit.local.overstock).max(initial=0.0)) / SCALE
