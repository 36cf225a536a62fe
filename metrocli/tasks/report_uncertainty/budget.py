"""The budget of each measurand, and the reverse budget of those that have a target."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.uncertainty.distributions import in_trials
from metrocli.uncertainty.inputs import Inputs
from metrocli.uncertainty.propagation import Coverage, LinearPropagation, budget_order, coverage_factor, whole_dof
from metrocli.units import column_unit, rounded
from metrocli.words import listed

_LINES = 20
"""Most contributors on the terminal"""


@dataclass(frozen=True)
class MeasurandBudget:
    """What the budget of one measurand is made of."""

    measurand: str
    unit: str
    factor: float
    """Size of the unit in base units"""
    linear: LinearPropagation
    inputs: Inputs
    target: float | None = None
    """Wanted U, in the unit of the measurand"""
    needed: Array | None = None
    """(n,): factor of the standard uncertainty of each input with which the target is reached; NaN: by none"""

    @property
    def shares(self) -> Array:
        """(n,): share of each contributor in the variance [percent]; of correlated ones it can be negative."""
        slopes = self.linear.sensitivities
        parts = slopes * (self.inputs.covariance @ slopes)
        shares: Array = 100 * parts / self.linear.std**2 + 0.0 if self.linear.std > 0 else np.zeros(len(parts))
        return shares


_HEADINGS = (
    "measurand [text]", "contributor [text]", "value", "std", "unit [text]", "distribution [text]", "sensitivity [1]",
    "contribution [1]", "share [percent]", "dof [1]",
)  # fmt: skip
_REVERSE = ("measurand [text]", "contributor [text]", "std", "needed_std", "unit [text]", "target [text]")


def tables(budgets: Sequence[MeasurandBudget]) -> dict[str, Table]:
    """Return the budget, one row for each measurand and contributor, and the reverse budget if there are targets."""
    result = {"budget": Table.of_rows(_HEADINGS, [row for budget in budgets for row in _rows(budget)])}
    reverse = [row for budget in budgets for row in _reverse_rows(budget)]
    return result | ({"reverse_budget": Table.of_rows(_REVERSE, reverse)} if reverse else {})


def _rows(budget: MeasurandBudget) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a measurand, the largest contribution first."""
    linear, shares = budget.linear, budget.shares
    for i in budget_order(linear):
        item = budget.inputs.quantities[i]
        scale = item.unit.factor
        shape = in_trials(item.distribution, item.dof).words if item.distribution else "constant"
        yield (
            budget.measurand, item.name, item.value / scale, item.std / scale, item.unit.text, shape,
            linear.sensitivities[i] * scale / budget.factor, linear.contributions[i] / budget.factor, shares[i],
            item.dof,
        )  # fmt: skip


def _reverse_rows(budget: MeasurandBudget) -> Iterator[tuple[Any, ...]]:
    if budget.needed is None:
        return
    for i in budget_order(budget.linear):
        item, needed = budget.inputs.quantities[i], float(budget.needed[i])
        if item.std > 0:
            words = "reached by this input alone" if math.isfinite(needed) else "cannot be reached by this input alone"
            std = item.std / item.unit.factor
            yield budget.measurand, item.name, std, needed * std, item.unit.text, words


def lines(budget: MeasurandBudget) -> list[str]:
    """Return a budget as lines of text with aligned columns."""
    rows = [("contributor", "value", "u", "unit", "sensitivity", "contribution", "share %", "dof")]
    order, linear, shares = budget_order(budget.linear), budget.linear, budget.shares
    for i in order[:_LINES]:
        item = budget.inputs.quantities[i]
        scale = item.unit.factor
        dof = f"{item.dof:.4g}" if math.isfinite(item.dof) else "-"
        slope, brings = linear.sensitivities[i] * scale / budget.factor, linear.contributions[i] / budget.factor
        value, std = rounded(item.value / scale, item.std / scale)
        rows.append((item.name, value, std, item.unit.text, f"{slope:.4g}", f"{brings:.3g}", f"{shares[i]:.1f}", dof))
    more = [f"... {len(order) - _LINES} more (show --table budget)"] if len(order) > _LINES else []
    return aligned(rows, left=(0, 3)) + more


def reverse_lines(budget: MeasurandBudget, reverse: Mapping[str, Any]) -> list[str]:
    """Return a reverse budget as lines of text; `reverse` has the U and the target of the measurand."""
    if budget.target is None:
        return []
    size, unit = column_unit(budget.target, budget.unit)
    head = f"target U = {budget.target / size:.6g} {unit}".strip()
    if reverse["reached"]:
        return [f"{head}: reached"]
    if budget.needed is None:
        return [f"{head}: not reached; the law of propagation does not apply, so no input can be named"]
    rows, unable = [("contributor", "u", "needed u", "unit")], []
    for i in budget_order(budget.linear):
        item, factor = budget.inputs.quantities[i], float(budget.needed[i])
        std = item.std / item.unit.factor
        if math.isfinite(factor):
            size, unit = column_unit(factor * std, item.unit.text)
            rows.append((item.name, f"{std / size:.3g}", _at_most(factor * std / size), unit))
        elif item.std > 0:
            unable.append(item.name)
    printed = [f"{head}: not reached"]
    if len(rows) > 1:
        printed += [
            "one of these inputs alone reaches it, with the needed u:",
            *aligned(rows[: _LINES + 1], left=(0, 3)),
        ]
    if unable:
        printed.append(f"cannot be reached by this input alone: {listed(unable, _LINES)}")
    return [*printed, f"all inputs together reach it with {_at_most(100 * reverse['factor'])} % of their u"]


def _at_most(value: float) -> str:
    """Return a value to three digits, rounded down."""
    if value <= 0:
        return "0"
    digits = 2 - math.floor(math.log10(value))
    return f"{math.floor(value * 10.0**digits * (1 + 1e-12)) / 10.0**digits:.3g}"


def aligned(rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> list[str]:
    """Return rows as lines with aligned columns; the columns in `left` are left-aligned, the others right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = zip(row, widths, strict=True)
        lines.append("  ".join(c.ljust(w) if k in left else c.rjust(w) for k, (c, w) in enumerate(cells)).rstrip())
    return lines


_STEPS = 1000
_HALVINGS = 40
_factor = lru_cache(4096)(coverage_factor)


@dataclass(frozen=True)
class _Scaled:
    """U of a measurand as a function of the factor of one input: its group apart from all others."""

    coverage: Coverage
    others: float
    """Variance of the other groups"""
    others_over_dof: float
    """Sum of their squared variances over their degrees of freedom"""
    own: tuple[float, float, float]
    """a, 2b and c of the group of the input"""
    dof: float

    def expanded(self, s: Array) -> Array:
        """Return U at each factor (n,)."""
        a, b, c = self.own
        variance = np.maximum(a + b * s + c * s * s, 0.0)
        total, weighted = self.others + variance, self.others_over_dof + variance**2 / self.dof
        with np.errstate(divide="ignore", invalid="ignore"):
            dof = np.where(weighted > 0, total**2 / weighted, np.inf)
        k = [_factor(self.coverage, whole_dof(each)) for each in dof.tolist()]
        result: Array = np.array(k) * np.sqrt(total)
        return result


def needed_factors(linear: LinearPropagation, inputs: Inputs, coverage: Coverage, wanted: float) -> Array:
    """Return for each input (n,) the largest factor of its standard uncertainty with which U is at most `wanted`.

    It is 1 where U is small enough already, and NaN where no factor of this input alone suffices.
    """
    shares = np.outer(linear.sensitivities, linear.sensitivities) * inputs.covariance
    factors = np.full(len(shares), np.nan)
    groups = [(list(group), _dof(group, inputs, linear)) for group in inputs.groups]
    variances = [float(shares[np.ix_(group, group)].sum()) for group, _ in groups]
    weighted = [variance**2 / dof for variance, (_, dof) in zip(variances, groups, strict=True)]
    for at, (group, dof) in enumerate(groups):
        others = sum(variances) - variances[at], sum(weighted) - weighted[at]
        for i in group:
            c, both = float(shares[i, i]), 2 * float(shares[i, group].sum() - shares[i, i])
            own = (variances[at] - both - c, both, c)
            others = (max(others[0], 0.0), max(others[1], 0.0))
            factors[i] = _largest(_Scaled(coverage, *others, own, dof), wanted) if c > 0 else np.nan
    return factors


def _dof(group: tuple[int, ...], inputs: Inputs, linear: LinearPropagation) -> float:
    """Return the least degrees of freedom of the inputs of a group that act, as the effective ones count them."""
    acting = [i for i in group if linear.sensitivities[i] != 0 and inputs.covariance[i, i] > 0]
    return min((inputs.quantities[i].dof for i in acting), default=np.inf)


def _largest(scaled: _Scaled, wanted: float) -> float:
    """Return the largest factor up to 1 with U at most `wanted`, NaN without one; U can have steps, by k."""
    grid = np.linspace(1.0, 0.0, _STEPS + 1)
    reached = scaled.expanded(grid) <= wanted
    if not reached.any():
        return float("nan")
    first = int(np.argmax(reached))
    low, high = float(grid[first]), float(grid[max(first - 1, 0)])
    for _ in range(_HALVINGS if first else 0):
        middle = (low + high) / 2
        if scaled.expanded(np.array([middle]))[0] <= wanted:
            low = middle
        else:
            high = middle
    return low
