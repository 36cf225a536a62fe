"""Correlations of a job: checks of the declared ones, and those of readings taken together."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import Placed
from metrocli.table import Table
from metrocli.tasks.report_uncertainty.copied_readings import same
from metrocli.uncertainty.inputs import Block, NotSemiDefiniteError, Quantity
from metrocli.words import suggestion


def misnamed(declared: Sequence[Placed], known: Collection[str], with_results: bool) -> Iterable[Fault]:
    """Yield a fault for each name that is not a quantity, and for each pair that is given twice."""
    seen: set[frozenset[str]] = set()
    for placed in declared:
        pair = placed.value.between
        for name in pair:
            if name not in known and (with_results or "." not in name):
                said = f"correlation of '{name}', which is not a quantity"
                yield placed.node.at("between").fault(said, suggestion(name, known))
        if frozenset(pair) in seen:
            yield placed.node.fault(f"the correlation of {pair[0]} and {pair[1]} is given twice", "give it once")
        seen.add(frozenset(pair))


def refused(declared: Sequence[Placed], quantities: Mapping[str, Quantity], blocks: Sequence[Block]) -> Iterable[Fault]:
    """Yield a fault for each pair of estimates of one result, and for each quantity without uncertainty."""
    for placed in declared:
        a, b = placed.value.between
        if any(a in block.names and b in block.names for block in blocks):
            said = f"{a} and {b} are estimates of one result, which contains their covariance"
            yield placed.node.fault(said, "leave this correlation out")
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
    said: str


def simultaneous(readings: Iterable[tuple[str, Table, str]], given: Collection[frozenset[str]]) -> list[Together]:
    """Return the correlations of quantities read in the same rows of a file (JCGM 100, 5.2.3) or in a copy of it.

    Pairs with a declared correlation (`given`) are left out.
    """
    found = []
    for (a, first, one), (b, second, other) in combinations(readings, 2):
        if frozenset((a, b)) in given:
            continue
        x, y = first.numbers(one), second.numbers(other)
        if first.file == second.file:
            r = float(np.corrcoef(x, y)[0, 1])
            said = f"{a} and {b} are columns of one file, {first.file}: the correlation of its rows, {r:+.3f}, is used"
            found.append(Together((a, b), r, f"{said}; declare 0 if they were not read together"))
        elif same(x, y):
            said = f"{a} and {b} have the same readings, value for value ({first.file}, {second.file})"
            found.append(Together((a, b), 1.0, f"{said}: correlation +1 is used; declare 0 if neither is a copy"))
    return found


def contradiction(error: NotSemiDefiniteError, declared: Sequence[Placed], otherwise: Node) -> Fault:
    """Return the fault of contradictory correlations, at the first of those involved, otherwise at `otherwise`."""
    pairs = [placed for placed in declared if set(placed.value.between) <= set(error.names)]
    hint = "no quantities can have all of them: one is too large, or has the wrong sign"
    if not pairs:
        said = f"the covariance of {', '.join(error.names)} is not positive semi-definite ({error.eigenvalue:.3g})"
        return otherwise.fault(said, hint)
    each = (f"r({', '.join(placed.value.between)}) = {placed.value.value:g}" for placed in pairs)
    said = f"these correlations contradict each other: {', '.join(each)} (smallest eigenvalue {error.eigenvalue:.3g})"
    return pairs[0].node.fault(said, hint)
