"""Notes and warnings of a fitted part, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.arrays import Mask
from metrocli.errors import NotConvergedError
from metrocli.table import Table
from metrocli.tasks.fit_part.contradiction import motions_without
from metrocli.tasks.fit_part.draws import DRAWS
from metrocli.tasks.fit_part.fit import MOST, max_least_overstock_of_many
from metrocli.tasks.fit_part.solve import FittedPart, fitted_part
from metrocli.tasks.shared.part import taken_as_exact
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of
from metrocli.words import counted, in_a_row, listed

_ALIKE = 1e-7
"""Difference of overstock up to which points are equally low: more than `most` gives up [mm]"""
_DEPENDENT = 1e-6
"""Share of a direction of rows, relative to the largest, below which it is rounding"""
WRONG, MATERIAL = "wrong", 0.1
"""Reason of a point farther from the level of its surface than this share of the part: chips and flash are smaller"""
_LIKELY = 0.05
"""Chance of a surface that stays unclean from which a warning names it"""


def notes(solved: FittedPart, holding: Table) -> Iterator[str]:
    """Yield what holds the part, what stays open, and where its uncertainty comes from."""
    fit, minimum = solved.fit, solved.minimum
    least = float(fit.local.overstock.min())
    largest = f"at most {solved.largest:.3f} mm is possible" if np.isfinite(solved.largest) else "it has no upper limit"
    yield f"least overstock {least:.3f} mm, minimum {minimum:.3f} mm ({largest})"
    share = holding.numbers("share")
    each = [
        f"{surface} ({point}, {100 * part:.0f} %)"
        for surface, point, part in zip(holding.texts("surface"), holding.texts("point"), share, strict=True)
    ]
    lowest = fit.local.overstock < least + _ALIKE
    others = int((exchanged(solved, lowest | (fit.duals > 0)) & (fit.duals == 0)).sum())
    if each and others:
        more = "1 more is" if others == 1 else f"{others} more are"
        yield f"held by: {listed(each)}; {more} as low and can hold it as well, so shares are one choice"
    elif each:
        yield f"held by: {listed(each)}; without these points the aim '{solved.aim.name}' would be better met"
    else:
        yield "held by: no point; the best pose has more than the minimum everywhere"
    free = motions_without(solved.stock, fit.local, lowest) if solved.aim.name == MOST else []
    if free:
        yield f"motions that no point with the least overstock holds, so even overstock decides: {in_a_row(free)}"
    if solved.prepared.part is not None:
        yield solved.prepared.part.note
    if solved.sensitivity.drawn:
        drawn = (
            f"the covariance of the pose is that of {DRAWS} fits to points with drawn errors, since errors exchange "
            "the points that hold it"
        )
        if solved.aim.name == MOST and others:
            drawn += "; these are linear, too little for points as low to rounding: `monte_carlo` fits each anew"
        yield drawn


def exchanged(solved: FittedPart, low: Mask) -> Mask:
    """Return which of the low points (n,) others can stand for: their rows depend on those of the others.

    A point that is as low by chance, such as one that ends a motion which no other holds, has a dual of 0 alone.
    """
    rows = solved.fit.local.rows[low]
    # with the aim `most` the sum of the shares is given, too
    balanced = np.c_[rows, np.ones(len(rows))] if solved.aim.name == MOST else rows
    directions, size, _ = np.linalg.svd(balanced, full_matrices=False)
    fixed = (directions[:, size > _DEPENDENT * size[0]] ** 2).sum(axis=1)
    mask = np.zeros(len(low), dtype=bool)
    mask[low] = fixed < 1 - _DEPENDENT
    return mask


def warnings(solved: FittedPart, surfaces: Table, rejected: Table) -> Iterator[str]:
    """Yield what may be wrong with the measurement or the part."""
    each = (
        ("chip", "material is missing"),
        ("flash", "material stands out"),
        (WRONG, "a chip or flash would be larger than a tenth of the part: look at coordinates, names and the part"),
    )
    for reason, what in each:
        rows = [row for row, text in enumerate(rejected.texts("reason")) if text == reason]
        if rows:
            off = np.abs(rejected.numbers("off")[rows])
            names = [rejected.texts("point")[row] for row in rows]
            count = counted(len(rows), "point", "are")
            yield (
                f"{count} left out as {reason}: {listed(names, 5)}, up to {off.max():.2f} mm from the level of the "
                f"surface; {what} (table rejected); `outliers: report` keeps all points"
            )
    minimum, of_used = solved.minimum, solved.fit.local.overstock
    if minimum < 0:
        missing = int((of_used < 0).sum())
        yield (
            f"the minimum is negative: up to {-minimum:g} mm of material may be missing at a point; "
            f"it is at {missing} of {len(of_used)} points (overstock below 0)"
        )
    low = [
        f"{point} ({value:.2f} mm)"
        for point, value, reason in zip(
            rejected.texts("point"), rejected.numbers("overstock"), rejected.texts("reason"), strict=True
        )
        if value < minimum and reason != WRONG
    ]
    if low:
        yield f"points left out have less than the minimum overstock, the surface stays unclean there: {listed(low, 5)}"
    outlying = np.flatnonzero(solved.levels.outlying & solved.used)
    if outlying.size:
        names = [solved.prepared.readings.surface_points.names[row] for row in outlying]
        yield (
            f"points far from the level of their surface take part: {listed(names, 5)}; "
            "`outliers: remove` leaves them out"
        )
    unclean = [
        f"{name} ({100 * chance:.0f} %)"
        for name, chance in zip(surfaces.texts("surface"), surfaces.numbers("below"), strict=True)
        if chance > _LIKELY
    ]
    if unclean and solved.prepared.readings.surface_points.covariance.any():
        yield (
            f"chance that the overstock is below the minimum somewhere, by errors of measurement: {in_a_row(unclean)}; "
            "a larger minimum allows for them"
        )


_STEEL = units.parse_quantity("11.5 ppm", "ratio")
"""Growth of steel by 1 K"""


def uncontrolled(solved: FittedPart) -> Table:
    """Return what the overstock absorbs, and its largest change by a plausible size of each."""
    return table_of(_rows(solved))


def _rows(solved: FittedPart) -> Iterator[Hidden]:
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


def by_scale(solved: FittedPart) -> float:
    """Return the largest change of an overstock by a relative change of the scale of the points [mm].

    The part is fitted again to points that are larger about their middle; NaN where it then has no pose.
    """
    stock, begin = solved.stock, (solved.fit.to_part, np.inf, solved.fit.duals)
    middle = stock.measured.mean(axis=0)
    larger = replace(stock, measured=middle + (stock.measured - middle) * (1 + SCALE))
    if solved.aim.name == MOST:
        begin = max_least_overstock_of_many(larger, solved.fit.to_part)
    try:
        _, fitted = fitted_part(larger, solved.aim.name, solved.minimum, begin, solved.prepared.start)
    except NotConvergedError:
        return float("nan")
    return float(np.abs(fitted.local.overstock - solved.fit.local.overstock).max(initial=0.0)) / SCALE
