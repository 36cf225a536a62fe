"""metrocli compare: two results of one kind compared, or repeated calibrations."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo, echo_json
from metrocli.cli.look import repeated
from metrocli.cli.look.opened import opened_result, require_option, requirement_of
from metrocli.words import listed

if TYPE_CHECKING:
    from metrocli.record import Record
    from metrocli.result import Result
    from metrocli.uncertainty.comparison import Comparison

FIGURES = ("max_en", "p_value", "chi2")
"""What --require can take for two results"""


@click.command(
    "compare",
    help="Differences of two results, with their uncertainty, E_n and one test of all; of more: drift and scatter.",
)
@click.argument("first", type=click.Path(path_type=Path), metavar="A.h5")
@click.argument("others", type=click.Path(path_type=Path), metavar="B.h5 [C.h5 ...]", nargs=-1, required=True)
@click.option("--days", metavar="0,90,...", help="Days at which three or more results were measured; else numbered.")
@click.option("--sets", is_flag=True, help="Three or more results are repeated sets without an order: their scatter.")
@require_option("'max_en < 1' or 'p_value > 0.05'; of more results 'max_drift_en < 1', of sets 'max_ratio < 2'")
@options.JSON
def command(
    first: Path, others: tuple[Path, ...], days: str | None, sets: bool, require: str | None, as_json: bool
) -> int:
    """Print B minus A, or what repeated measurements show; raises UsageError for a wrong condition or wrong days."""
    if sets or len(others) > 1 or days is not None:
        files = (first, *others)
        return repeated.sets(files, days, require, as_json) if sets else repeated.series(files, days, require, as_json)
    (second,) = others
    from metrocli.uncertainty.comparison import compare

    wanted = requirement_of(require, FIGURES)
    (before, of_one), (other, of_other) = opened_result(first), opened_result(second)
    comparison, shared = compare(before, other), _shared(of_one, of_other)
    lenses = _lenses(before, other)
    if as_json:
        echo_json({**_figures(comparison, shared), **({"lens_difference": lenses} if lenses else {})})
    else:
        echo("\n".join([_text(comparison, shared), *_lenses_in_text(lenses, first, second)]))
    return 0 if wanted is None else wanted.exit_code(comparison)


def _shared(first: Record, second: Record) -> list[str]:
    """Return the paths of the inputs of the first result that the second was made from too, by content."""
    known = {file.sha256 for file in second.inputs}
    return [file.path for file in first.inputs if file.sha256 in known]


def _lenses(first: Result, second: Result) -> dict[str, dict[str, float]]:
    """Return by how much the lenses of each camera of two calibrations differ over the image, by their names."""
    if {first.kind, second.kind} != {"calibrate-camera"}:
        return {}
    from metrocli.tasks.shared.images.calibrated import lens_differences

    sizes = ((camera.name, camera.rms, *camera.largest) for camera in lens_differences(first, second))
    return {name or "camera": {"rms": rms, "largest": worst, "u": u, "v": v} for name, rms, worst, u, v in sizes}


def _lenses_in_text(lenses: dict[str, dict[str, float]], first: Path, second: Path) -> Iterator[str]:
    for name, of in lenses.items():
        place = f"at ({of['u']:.0f}, {of['v']:.0f}) px"
        size = f"{of['rms']:.2g} px (root mean square), {of['largest']:.2g} px at most, {place}"
        yield f"{name}, over the image after the best rotation: {size}"
    if lenses:
        yield f"shown by: metrocli plot {second} lens-difference --before {first}"


def _figures(comparison: Comparison, shared: list[str]) -> dict[str, Any]:
    groups: dict[str, dict[str, Any]] = {"estimates": {}, "points": {}}
    for quantity in comparison.compared:
        row = {"difference": quantity.difference, "std": quantity.std, "unit": quantity.unit, "en": quantity.en}
        if quantity.group in groups:
            groups[quantity.group][quantity.name] = row
        else:
            groups.setdefault("tables", {}).setdefault(quantity.group, {})[quantity.name] = row
    figures = {
        "chi2": comparison.chi2,
        "dof": comparison.dof,
        "p_value": comparison.p_value,
        "max_en": comparison.max_en,
    }
    return {
        **groups,
        **figures,
        "shared": shared,
        "counted_once": list(comparison.counted_once),
        "only_in_one": list(comparison.only_in_one),
    }


def _text(comparison: Comparison, shared: list[str]) -> str:
    from metrocli import units
    from metrocli.cli.columns import worst_rows

    rows = [["quantity", "B - A (± u)", "E_n"]]
    for quantity in sorted(comparison.compared, key=lambda quantity: -quantity.en):
        name = quantity.name if quantity.group == "estimates" else f"{quantity.group} {quantity.name}"
        rows.append(
            [name, units.format_quantity(quantity.difference, quantity.unit, quantity.std), f"{quantity.en:.2f}"]
        )
    lines = worst_rows(rows)
    lines.append(f"{len(comparison.compared)} quantities, largest E_n {comparison.max_en:.2f}")
    lines.append(
        f"estimates and error tables together: chi2 {comparison.chi2:.4g} of {comparison.dof} degrees of freedom, "
        f"p {comparison.p_value:.3g}"
    )
    independent = "the uncertainties count as independent"
    if comparison.counted_once:
        once = f"what they share by {', '.join(comparison.counted_once)} counts once"
        lines.append(f"{once}; other inputs count as independent" + (f": both have {listed(shared)}" if shared else ""))
    elif shared:
        lines.append(f"both are made from {listed(shared)}; {independent} all the same")
    else:
        lines.append(f"the results have no input in common; {independent}")
    if comparison.only_in_one:
        lines.append(f"determined in one of them only: {listed(comparison.only_in_one)}")
    return "\n".join(lines)
