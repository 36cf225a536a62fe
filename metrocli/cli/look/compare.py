"""metrocli compare: two results of one kind held against each other, or the scatter of three or more."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo
from metrocli.cli.look import requirement

if TYPE_CHECKING:
    from metrocli.record import Record
    from metrocli.uncertainty.comparison import Comparison
    from metrocli.uncertainty.repeated import Repetition

FIGURES = ("max_en", "p_value", "chi2")
"""What --require can take for two results"""
FIGURES_OF_SETS = ("max_ratio",)
"""What it can take for more"""


@click.command(
    "compare",
    help="Differences of two results, with their uncertainty, E_n and one test of all; of more, their scatter.",
)
@click.argument("first", type=click.Path(path_type=Path), metavar="A.h5")
@click.argument("second", type=click.Path(path_type=Path), metavar="B.h5")
@click.argument("more", type=click.Path(path_type=Path), metavar="[C.h5 ...]", nargs=-1)
@requirement.option("'max_en < 1' or 'p_value > 0.05', of more results 'max_ratio < 2'")
@options.JSON
def command(first: Path, second: Path, more: tuple[Path, ...], require: str | None, as_json: bool) -> int:
    """Print B minus A for all that both results determine; raises UsageError for a wrong condition."""
    from metrocli.cli import summary
    from metrocli.formats import hdf5
    from metrocli.uncertainty.comparison import compare

    if more:
        return _repeated((first, second, *more), require, as_json)
    wanted = requirement.read(require, FIGURES)
    (one, of_one), (other, of_other) = hdf5.read(first), hdf5.read(second)
    found, shared = compare(one, other), _shared(of_one, of_other)
    echo(summary.as_json(_figures(found, shared)) if as_json else _text(found, shared))
    return 0 if wanted is None else wanted.exit_code(found)


def _repeated(files: tuple[Path, ...], require: str | None, as_json: bool) -> int:
    """Print how far repeated sets scatter."""
    from metrocli.cli import summary
    from metrocli.formats import hdf5
    from metrocli.uncertainty.repeated import repetition

    wanted = requirement.read(require, FIGURES_OF_SETS)
    found = repetition([hdf5.read(file)[0] for file in files])
    echo(summary.as_json(_figures_of_sets(found)) if as_json else _text_of_sets(found))
    return 0 if wanted is None else wanted.exit_code(found)


def _figures_of_sets(found: Repetition) -> dict[str, Any]:
    groups: dict[str, Any] = {"sets": found.sets}
    for one in found.quantities:
        row = {"mean": one.mean, "sigma": one.sigma, "std": one.std, "unit": one.unit, "ratio": one.ratio}
        groups.setdefault(one.group, {})[one.name] = row
    return {**groups, "max_ratio": found.max_ratio}


def _text_of_sets(found: Repetition) -> str:
    from metrocli import units
    from metrocli.cli.columns import worst_rows

    rows = [["quantity", "mean", "sigma", "stated", "sigma/stated"]]
    for one in sorted(found.quantities, key=lambda one: -one.ratio):
        name = one.name if one.group == "estimates" else f"{one.group} {one.name}"
        mean = "" if math.isnan(one.mean) else units.format_quantity(one.mean, one.unit, one.sigma)
        rows.append([name, mean, f"{one.sigma:.3g} {one.unit}", f"{one.std:.3g} {one.unit}", f"{one.ratio:.2f}"])
    lines = worst_rows(rows)
    lines.append(f"{found.sets} sets, {len(found.quantities)} quantities, largest sigma/stated {found.max_ratio:.2f}")
    return "\n".join(lines)


def _shared(first: Record, second: Record) -> list[str]:
    """Return the paths of the inputs of the first result that the second was made from too, by content."""
    known = {one.sha256 for one in second.inputs}
    return [one.path for one in first.inputs if one.sha256 in known]


def _figures(found: Comparison, shared: list[str]) -> dict[str, Any]:
    groups: dict[str, dict[str, Any]] = {"estimates": {}, "points": {}}
    for one in found.compared:
        row = {"difference": one.difference, "std": one.std, "unit": one.unit, "en": one.en}
        if one.group in groups:
            groups[one.group][one.name] = row
        else:
            groups.setdefault("tables", {}).setdefault(one.group, {})[one.name] = row
    figures = {"chi2": found.chi2, "dof": found.dof, "p_value": found.p_value, "max_en": found.max_en}
    return {**groups, **figures, "shared": shared, "only_in_one": list(found.only_in_one)}


def _text(found: Comparison, shared: list[str]) -> str:
    from metrocli import units
    from metrocli.cli.columns import worst_rows

    rows = [["quantity", "B - A", "E_n"]]
    for one in sorted(found.compared, key=lambda one: -one.en):
        name = one.name if one.group == "estimates" else f"{one.group} {one.name}"
        rows.append([name, units.format_quantity(one.difference, one.unit, one.std), f"{one.en:.2f}"])
    lines = worst_rows(rows)
    lines.append(f"{len(found.compared)} quantities, largest E_n {found.max_en:.2f}")
    lines.append(f"all together: chi2 {found.chi2:.4g} of {found.dof} degrees of freedom, p {found.p_value:.3g}")
    if shared:
        lines.append(f"both are made from {', '.join(shared)}; the uncertainties count as independent all the same")
    if found.only_in_one:
        lines.append(f"determined in one of them only: {len(found.only_in_one)} quantities")
    return "\n".join(lines)
