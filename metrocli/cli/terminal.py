"""Results and plans as text: the status first, then values to the second digit of their standard uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrocli import units
from metrocli.cli.columns import columns_text, table_text
from metrocli.cli.console import echo
from metrocli.plan import Plan
from metrocli.record import DONE, FAIL, Record
from metrocli.report.html import compound_unit, stated
from metrocli.result import SCALE, Estimate, Result, ShownTable
from metrocli.table import Table

_FIRST = ("observations", "unknowns", "dof", "sigma0", "chi2", "p_value", "iterations", "rms")


def result_text(result: Result, record: Record, path: Path) -> str:
    """Return the summary of a result as text: whether it may be used and what that rests on, then its values."""
    parts = [f"{result.kind}{f': {result.title}' if result.title else ''}", _status_line(result, record)]
    parts += _doubt_lines(record)
    parts += filter(None, [_statistics_line(result.statistics)])
    parts += map(str, record.verdicts)
    parts += ["", estimates_text(result.estimates, stated(result, record))] if result.estimates else []
    parts += ["", *result.notes] if result.notes and result.notes[0] else result.notes
    parts += [_shown(result.tables, shown) for shown in result.shown if shown.name in result.tables]
    return "\n".join([*parts, f"result: {path}"])


def _status_line(result: Result, record: Record) -> str:
    count = len(result.warnings)
    decided = f", conformity: {record.conformity}" if record.conformity else ""
    status = DONE if record.status == FAIL else record.status
    return f"status: {status}{decided}" + (f", {count} warning{'s' if count > 1 else ''}" if count else "")


def plan_text(plan: Plan, job_text: str = "") -> str:
    """Return the summary of a plan as text."""
    parts = [f"{plan.kind}: planned", *plan.notes]
    parts += [estimates_text(plan.figures, job_text)] if plan.figures else []
    return "\n".join([*parts, *(_shown(plan.tables, shown) for shown in plan.shown)])


def print_unfit(record: Record, printed: bool = False) -> int:
    """Print to stderr why a result is not fit for use, unless already printed; return the exit code.

    That is, each acceptance criterion that is not met and each doubt.
    """
    unmet = [str(verdict) for verdict in record.verdicts if not verdict.met]
    for line in () if printed else (*unmet, *_doubt_lines(record)):
        echo(line, err=True)
    return record.exit_code


def _doubt_lines(record: Record) -> list[str]:
    return [f"DOUBTFUL: {doubt}" for doubt in record.doubts]


def estimates_text(estimates: Sequence[Estimate], job_text: str = "") -> str:
    """Return a heading, and a line for each estimate: name, value, standard uncertainty and unit.

    The parameters of effects are in the unit that the job states for them, else in one that suits their uncertainty;
    those of one name share it.
    """
    groups: dict[tuple[str, str], list[Estimate]] = {}
    for estimate in estimates:
        groups.setdefault(_alike(estimate), []).append(estimate)
    unit_by_group = {alike: _unit(group, job_text) for alike, group in groups.items()}
    rows = columns_text([_estimate_row(estimate, *unit_by_group[_alike(estimate)]) for estimate in estimates])
    return f"value {units.SPREAD}:\n{rows}"


def _alike(estimate: Estimate) -> tuple[str, str]:
    return estimate.dimension, estimate.name.rpartition(".")[2] if estimate.dimension else estimate.unit


def _unit(group: Sequence[Estimate], job_text: str) -> tuple[float, str]:
    """Return the size of the unit of some estimates in their internal unit, and its symbol."""
    dimension, unit = group[0].dimension, group[0].unit
    about_one = dimension == SCALE
    dimension = "ratio" if about_one else dimension
    if not dimension:
        return compound_unit(group[0], job_text)
    symbol = units.written_unit(job_text, dimension, group[0].name.rpartition(".")[2])
    stds = [estimate.std for estimate in group if 0 < estimate.std < math.inf]
    symbol = symbol or units.readable(min(stds, default=abs(group[0].value)), dimension)[1]
    return (1.0, unit) if symbol in ("", "1") else (units.find_unit(symbol, dimension).inside(1.0), symbol)


def _estimate_row(estimate: Estimate, size: float, unit: str) -> list[str]:
    """Return name, value, standard uncertainty, unit; an angle also in mm/m or degrees, a scale also from 1."""
    scale = estimate.dimension == SCALE
    value, std = (estimate.value, estimate.std) if scale else (estimate.value / size, estimate.std / size)
    number, spread = units.rounded(value, std)
    if number == units.NOT_DETERMINED:
        return [estimate.name, number]
    shown = f"{value:.6g}" if std == 0 else number
    row = [estimate.name, shown, f"± {spread}" if std else "", "" if scale or unit == "1" else unit]
    if scale:
        row.append(f"({units.format_quantity((value - 1) / size, unit, std / size)} from 1)")
    if estimate.unit == "rad":
        slope, of_slope, symbol = units.as_slope(estimate.value, estimate.std)
        row.append(f"({units.format_quantity(slope, symbol, of_slope)})")
    return row


def _statistics_line(statistics: Mapping[str, Any]) -> str:
    parts = []
    for name in _FIRST:
        value = statistics.get(name)
        if isinstance(value, Mapping):
            parts += [f"{name} {_four_digits(number)} {unit}" for unit, number in value.items()]
        elif value is not None:
            parts.append(f"{name.replace('_value', '')} {_four_digits(value)}")
    return ", ".join(parts)


def _four_digits(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.4g}" if math.isfinite(value) else units.NOT_DETERMINED


def _shown(tables: Mapping[str, Table], shown: ShownTable) -> str:
    """Return a table, or the columns of it that are shown."""
    return f"\n{shown.name}\n{table_text(shown.of(tables[shown.name]))}"
