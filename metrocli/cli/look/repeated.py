"""What three or more results show: a series of calibrations in time, or repeated sets without an order."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrocli.cli.console import echo, echo_json
from metrocli.cli.look.opened import opened_result, requirement_of
from metrocli.errors import UsageError

if TYPE_CHECKING:
    from metrocli.uncertainty.repeated import RepeatedCalibrations
    from metrocli.uncertainty.repeated_sets import Repetition

OF_SERIES, OF_SETS = ("max_en", "max_drift_en"), ("max_ratio",)
"""What --require can take for them"""
FEWEST = 3
_ROUNDING = 1e-6
"""Scatter below this share of what is stated is that of the arithmetic: the sets are equal"""


def series(files: tuple[Path, ...], days: str | None, require: str | None, as_json: bool) -> int:
    """Print drift, pooled scatter and E_n against the first of several calibrations; return the exit code."""
    from metrocli.uncertainty.repeated import repeated

    wanted = requirement_of(require, OF_SERIES)
    times, time = _times(days, len(files))
    calibrations = repeated([opened_result(file)[0] for file in files], times)
    if as_json:
        echo_json(_figures_of_series(calibrations, files, times, time))
    else:
        echo(_text_of_series(calibrations, files, time))
    return 0 if wanted is None else wanted.exit_code(calibrations)


def _times(days: str | None, number: int) -> tuple[list[float], str]:
    """Return the times and their unit; without days the numbers of the calibrations."""
    if days is None:
        return [float(i) for i in range(number)], "calibration"
    try:
        times = [float(part) for part in days.split(",")]
    except ValueError:
        times = []
    if len(times) != number or not all(map(math.isfinite, times)):
        raise UsageError(f"--days '{days}': expected {number} numbers, one a result, such as '0,90,181'")
    return times, "d"


def _figures_of_series(
    repeats: RepeatedCalibrations, files: tuple[Path, ...], times: list[float], time: str
) -> dict[str, Any]:
    drift: dict[str, dict[str, Any]] = {}
    for compared in repeats.drifts:
        row = {
            "rate": compared.rate,
            "std": compared.std,
            "unit": f"{compared.unit}/{time}",
            "U": compared.expanded,
            "en": compared.en,
        }
        drift.setdefault(compared.group, {})[compared.name] = row
    pooled = [
        {"group": spread.group, "unit": spread.unit, "std": spread.std, "expected": spread.expected, "dof": spread.dof}
        for spread in repeats.pooled
    ]
    calibrations = [
        {"file": str(file), "time": at, "max_en": en}
        for file, at, en in zip(files, times, (0.0, *repeats.against_first), strict=True)
    ]
    figures = {"max_en": repeats.max_en, "max_drift_en": repeats.max_drift_en}
    return {"calibrations": calibrations, "drift": drift, "pooled": pooled, **figures}


def _text_of_series(calibrations: RepeatedCalibrations, files: tuple[Path, ...], time: str) -> str:
    from metrocli import units
    from metrocli.cli.columns import columns_text, worst_rows

    rows = [["quantity", f"drift per {time} (± u)", "E_n"]]
    for drift in sorted(calibrations.drifts, key=lambda drift: -drift.en):
        name = drift.name if drift.group == "estimates" else f"{drift.group} {drift.name}"
        rows.append([name, units.format_quantity(drift.rate, drift.unit, drift.std), f"{drift.en:.2f}"])
    scatter = [["group", "pooled standard deviation", "stated", "degrees of freedom"]]
    for group in calibrations.pooled:
        times, symbol = units.column_unit(group.expected, group.unit)
        sizes = (f"{value / times:.3g} {symbol}".rstrip() for value in (group.std, group.expected))
        scatter.append([group.group, *sizes, f"{group.dof}"])
    against = [["against the first", "largest E_n"]]
    against += [[str(file), f"{en:.2f}"] for file, en in zip(files[1:], calibrations.against_first, strict=True)]
    return "\n".join([*worst_rows(rows), "", columns_text(scatter), "", columns_text(against)])


def sets(files: tuple[Path, ...], days: str | None, require: str | None, as_json: bool) -> int:
    """Print how far repeated sets scatter; return the exit code."""
    if days is not None or len(files) < FEWEST:
        raise UsageError("--sets takes three or more results, and no --days")
    from metrocli.uncertainty.repeated_sets import repetition

    wanted = requirement_of(require, OF_SETS)
    repeats = repetition([opened_result(file)[0] for file in files])
    if as_json:
        echo_json(_figures_of_sets(repeats))
    else:
        echo(_text_of_sets(repeats))
    return 0 if wanted is None else wanted.exit_code(repeats)


def _figures_of_sets(repeats: Repetition) -> dict[str, Any]:
    groups: dict[str, Any] = {"sets": repeats.sets}
    for quantity in repeats.quantities:
        row = {
            "mean": quantity.mean,
            "sigma": quantity.sigma,
            "std": quantity.std,
            "unit": quantity.unit,
            "ratio": quantity.ratio,
        }
        groups.setdefault(quantity.group, {})[quantity.name] = row
    return {**groups, "max_ratio": repeats.max_ratio}


def _text_of_sets(repeats: Repetition) -> str:
    from metrocli import units
    from metrocli.cli.columns import worst_rows

    rows = [["quantity", "mean (± sigma)", "sigma", "stated", "sigma/stated"]]
    for quantity in sorted(repeats.quantities, key=lambda quantity: -quantity.ratio):
        name = quantity.name if quantity.group == "estimates" else f"{quantity.group} {quantity.name}"
        sigma = 0.0 if quantity.ratio < _ROUNDING else quantity.sigma
        mean = "" if math.isnan(quantity.mean) else units.format_quantity(quantity.mean, quantity.unit, sigma)
        size, unit = units.column_unit(quantity.std, quantity.unit)
        rows.append(
            [name, mean, *(f"{value / size:.3g} {unit}" for value in (sigma, quantity.std)), f"{quantity.ratio:.2f}"]
        )
    lines = worst_rows(rows, by="sigma/stated")
    lines.append(
        f"{repeats.sets} sets, {len(repeats.quantities)} quantities, largest sigma/stated {repeats.max_ratio:.2f}"
    )
    return "\n".join(lines)
