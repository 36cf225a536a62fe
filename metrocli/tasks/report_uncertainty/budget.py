"""The budget of each measurand, and the reverse budget of those that have a target."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.report_uncertainty.aligned_text import aligned
from metrocli.uncertainty.distributions import in_trials
from metrocli.uncertainty.inputs import Inputs
from metrocli.uncertainty.propagation import LinearPropagation, budget_order
from metrocli.units import rounded
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
    "measurand [text]", "contributor [text]", "value", "std", "unit [text]", "distribution [text]", "sensitivity",
    "contribution", "share [percent]", "dof",
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


def reverse_lines(budget: MeasurandBudget, found: Mapping[str, Any]) -> list[str]:
    """Return a reverse budget as lines of text; `found` has the U and the target of the measurand."""
    if budget.target is None:
        return []
    head = f"target U = {budget.target:.6g} {budget.unit}".strip()
    if found["reached"]:
        return [f"{head}: reached"]
    if budget.needed is None:
        return [f"{head}: not reached; the law of propagation does not apply, so no input can be named"]
    rows, unable = [("contributor", "u", "needed u", "unit")], []
    for i in budget_order(budget.linear):
        item, factor = budget.inputs.quantities[i], float(budget.needed[i])
        std = item.std / item.unit.factor
        if math.isfinite(factor):
            rows.append((item.name, f"{std:.3g}", _at_most(factor * std), item.unit.text))
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
    return [*printed, f"all inputs together reach it with {_at_most(100 * found['factor'])} % of their u"]


def _at_most(value: float) -> str:
    """Return a value to three digits, rounded down."""
    if value <= 0:
        return "0"
    digits = 2 - math.floor(math.log10(value))
    return f"{math.floor(value * 10.0**digits * (1 + 1e-12)) / 10.0**digits:.3g}"
