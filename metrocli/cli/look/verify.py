"""metrocli verify: a result held against independent measurements."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo
from metrocli.cli.look import requirement

if TYPE_CHECKING:
    from metrocli.record import Record
    from metrocli.result import Result
    from metrocli.table import Table
    from metrocli.uncertainty.verification import Verification

_LEAST = 0.95
"""Probability of U below which the reader has to know it"""
FIGURES = ("max_en", "inside")
"""What --require can take"""


@click.command(
    "verify", help="Independent points or lengths against what a result predicts, with U, E_n and share inside U."
)
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.argument("check", type=click.Path(path_type=Path), metavar="CHECK.csv")
@click.option("--aligned", is_flag=True, help="The points are in the frame of the result: do not lay them onto it.")
@requirement.option("'max_en < 1' or 'inside >= 0.95'")
@options.JSON
def command(result: Path, check: Path, aligned: bool, require: str | None, as_json: bool) -> int:
    """Print the deviations, measured minus predicted; raises UsageError for a wrong condition."""
    from metrocli.cli import summary
    from metrocli.formats import csv, hdf5
    from metrocli.formats.csv_text import read_text, taken_apart
    from metrocli.uncertainty.verification import columns_for, verify

    wanted = requirement.read(require, FIGURES)
    held, record = hdf5.read(result)
    header = taken_apart(read_text(check, str(check)), str(check)).header
    table = csv.read(check, columns_for(held, header))
    found = verify(held, table, aligned)
    for remark in _remarks(held, record, table):
        echo(f"warning: {remark}", err=True)
    echo(summary.as_json(_figures(found)) if as_json else _text(found))
    return 0 if wanted is None else wanted.exit_code(found)


def _remarks(result: Result, record: Record, check: Table) -> list[str]:
    """Return what the reader has to know of the file, the result and the uncertainties."""
    from metrocli.uncertainty.verification import covered

    remarks = [*check.warnings, *(f"the result is not fit for use: {reason}" for reason in record.reasons)]
    if "sigma" not in check:
        remarks.append("no column 'sigma_mm': U does not contain the uncertainty of the check")
    dof, probability = covered(result, 1 if "length" in check else 3)
    if probability < _LEAST:
        remarks.append(
            f"the uncertainties of the result have {dof:.3g} degrees of freedom: U covers {100 * probability:.3g} % of "
            "the deviations or somewhat more, not 95.45 %"
        )
    names = sorted({name.split("/")[1] for name in result.tables if name.startswith("effects/")})
    if names and "mx" in check:
        remarks.append(f"the prediction does not contain the effects in the result: {', '.join(names)}")
    return remarks


def _figures(found: Verification) -> dict[str, Any]:
    rows = []
    for one in found.deviations:
        row = {"point": one.name, "deviation": one.value, "unit": "mm", "U": one.expanded, "en": one.en}
        rows.append(row | ({"vector": one.vector} if one.vector else {}))
    names = ("mean", "rms", "largest", "inside", "max_en")
    return {"points": rows, **{name: getattr(found, name) for name in names}}


def _text(found: Verification) -> str:
    from metrocli.cli.columns import worst_rows

    rows = [["point", "deviation [um]", "U [um]", "E_n"]]
    for one in sorted(found.deviations, key=lambda one: -one.en):
        rows.append([one.name, f"{1e3 * one.value:.3f}", f"{1e3 * one.expanded:.3f}", f"{one.en:.2f}"])
    lines = worst_rows(rows)
    if found.laid:
        lines.append("the points are laid onto the prediction by a shift and a turn (--aligned: as they are)")
    mean, rms, largest = (f"{1e3 * value:.4g} um" for value in (found.mean, found.rms, found.largest))
    lines.append(f"{len(found.deviations)} deviations: mean {mean}, rms {rms}, largest {largest}")
    lines.append(f"inside U: {100 * found.inside:.3g} %, largest E_n {found.max_en:.2f}")
    return "\n".join(lines)
