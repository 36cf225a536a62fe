"""Correlations between quantities, and readings that stand in several files."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from metrocli.arrays import Array
from metrocli.copies import first_run, row_hashes
from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import LocatedValue
from metrocli.table import Table
from metrocli.uncertainty.inputs import CorrelatedBlock, InputQuantity, NotSemiDefiniteError
from metrocli.words import suggestion


def misnamed(declared: Sequence[LocatedValue], known: Collection[str], with_results: bool) -> Iterable[Fault]:
    """Yield a fault for each name that is not a quantity, and for each pair that is given twice."""
    seen: set[frozenset[str]] = set()
    for placed in declared:
        pair = placed.value.between
        for name in pair:
            if name not in known and (with_results or "." not in name):
                message = f"correlation of '{name}', which is not a quantity"
                yield placed.node.at("between").fault(message, suggestion(name, known))
        if frozenset(pair) in seen:
            yield placed.node.fault(f"the correlation of {pair[0]} and {pair[1]} is given twice", "give it once")
        seen.add(frozenset(pair))


def refused(
    declared: Sequence[LocatedValue], quantities: Mapping[str, InputQuantity], blocks: Sequence[CorrelatedBlock]
) -> Iterable[Fault]:
    """Yield a fault for each pair of estimates of one result, and for each quantity without uncertainty."""
    for placed in declared:
        a, b = placed.value.between
        if any(a in block.names and b in block.names for block in blocks):
            message = f"{a} and {b} are estimates of one result, which contains their covariance"
            yield placed.node.fault(message, "leave this correlation out")
        for name in (a, b):
            if quantities[name].std == 0:
                yield placed.node.fault(
                    f"{name} has no uncertainty, so it has no correlation", "leave this correlation out"
                )


@dataclass(frozen=True)
class Together:
    """A correlation calculated from readings, with the sentence that reports it."""

    between: tuple[str, str]
    value: float
    message: str


def simultaneous(readings: Iterable[tuple[str, Table, str]], given: Collection[frozenset[str]]) -> list[Together]:
    """Return the correlations of quantities read in the same rows of a file (JCGM 100, 5.2.3) or in a copy of it.

    Pairs with a declared correlation (`given`) are left out.
    """
    pairs = []
    for (a, first, pair), (b, second, other) in combinations(readings, 2):
        if frozenset((a, b)) in given:
            continue
        x, y = first.numbers(pair), second.numbers(other)
        if first.file == second.file:
            r = float(np.corrcoef(x, y)[0, 1])
            message = (
                f"{a} and {b} are columns of one file, {first.file}: the correlation of its rows, {r:+.3f}, is used"
            )
            pairs.append(Together((a, b), r, f"{message}; declare 0 if they were not read together"))
        elif same(x, y):
            message = f"{a} and {b} have the same readings, value for value ({first.file}, {second.file})"
            pairs.append(Together((a, b), 1.0, f"{message}: correlation +1 is used; declare 0 if neither is a copy"))
    return pairs


def contradiction(error: NotSemiDefiniteError, declared: Sequence[LocatedValue], otherwise: Node) -> Fault:
    """Return the fault of contradictory correlations, at the first of those involved, otherwise at `otherwise`."""
    pairs = [placed for placed in declared if set(placed.value.between) <= set(error.names)]
    hint = "no quantities can have all of them: one is too large, or has the wrong sign"
    if not pairs:
        message = f"the covariance of {', '.join(error.names)} is not positive semi-definite ({error.eigenvalue:.3g})"
        return otherwise.fault(message, hint)
    each = (f"r({', '.join(placed.value.between)}) = {placed.value.value:g}" for placed in pairs)
    message = (
        f"these correlations contradict each other: {', '.join(each)} (smallest eigenvalue {error.eigenvalue:.3g})"
    )
    return pairs[0].node.fault(message, hint)


_FEWEST = 3
"""Fewest readings of a run"""
_COARSE = 0.5
"""Share of equal readings from which a series is too coarse to be judged"""
_DECIMALS, _WHOLE, _ROUNDING = 16, 1e13, 2e-15
"""Most decimals of a reading, largest whole number that is compared, and relative rounding of a double in it"""
_UNLIKELY, _REFUSED = 1e-3, 1e-6
"""Chance below which a run is reported, and below which it is refused as in all other files of readings"""


def repeated(name: str, table: Table, column: str) -> Fault | str | None:
    """Return a fault, or a warning, for a run of readings that repeats an earlier one; None without one."""
    values = table.numbers(column)
    alike = _alike(values)
    pairs = len(values) ** 2 / 2
    if not 0 < alike < 1:
        return None
    least = max(_FEWEST, math.ceil(math.log(_UNLIKELY / pairs) / math.log(alike)))
    run = first_run(row_hashes(table, (column,)), least)
    if run is None:
        return None
    place = f"line {table.lines[run.first]}" if table.lines else f"row {run.first + 1}"
    message = f"{run.rows} readings of '{name}' repeat {place} and those after it, value for value"
    why = "one measurement that counts twice makes the uncertainty too small: remove the copy"
    if pairs * alike**run.rows < _REFUSED:
        return table.fault_at(run.again, message, why)
    return f"{table.file}: {message}; {why}"


def same(first: Array, second: Array) -> bool:
    """Return whether two series are equal value for value, and not by chance."""
    return np.array_equal(first, second) and len(first) >= _FEWEST and _alike(first) ** len(first) < _UNLIKELY


def _alike(values: Array) -> float:
    """Return the chance that two readings are equal, 1 for a series without spread.

    Of readings that differ from the one before them more are equal: `p / (1 - p)` bounds their share.
    """
    step = _resolution(values)
    if step == 0:
        return 1.0
    p = step / (2 * math.sqrt(math.pi) * float(values.std(ddof=1)))
    return p / (1 - p) if p < _COARSE else 1.0


def _resolution(values: Array) -> float:
    """Return the largest step of which all differences are multiples, 0 for a series without spread."""
    distinct = np.unique(values)
    steps = np.diff(distinct)
    if not len(steps):
        return 0.0
    for decimals in range(_DECIMALS):
        whole = distinct * 10.0**decimals
        largest = np.abs(whole).max()
        if largest > _WHOLE:
            break
        if np.abs(whole - np.rint(whole)).max() <= _ROUNDING * largest:
            return float(np.gcd.reduce(np.diff(np.rint(whole)).astype(np.int64))) / 10.0**decimals
    return float(steps.min())
