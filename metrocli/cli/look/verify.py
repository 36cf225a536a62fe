"""metrocli verify: a result held against independent measurements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo
from metrocli.cli.look import requirement
from metrocli.cli.look.held import held
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.result import Result
    from metrocli.table import Table
    from metrocli.uncertainty.length_errors import LengthError
    from metrocli.uncertainty.verification import Verification

FIGURES = ("max_en", "inside", "mpe_ratio")
"""What --require can take"""


@click.command(
    "verify", help="Independent points or lengths against what a result predicts, with U, E_n and share inside U."
)
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.argument("check", type=click.Path(path_type=Path), metavar="CHECK.csv")
@click.option("--aligned", is_flag=True, help="The points are in the frame of the result: do not lay them onto it.")
@click.option(
    "--mpe",
    metavar="'A + B'",
    help="Lengths against a maximum permissible error, such as '1.5 um + 3 um/m' (ISO 10360-2).",
)
@requirement.option("'max_en < 1' or 'inside >= 0.95'")
@options.JSON
def command(result: Path, check: Path, aligned: bool, mpe: str | None, require: str | None, as_json: bool) -> int:
    """Print the deviations, measured minus predicted; raises UsageError for a wrong condition."""
    from metrocli.cli import summary
    from metrocli.formats import csv
    from metrocli.formats.csv_text import read_text, taken_apart
    from metrocli.uncertainty.length_errors import length_errors, permitted
    from metrocli.uncertainty.verification import columns_for, verify

    wanted = requirement.read(require, FIGURES if mpe else FIGURES[:2])
    limit = None if mpe is None else permitted(mpe)
    calibrated, _ = held(result)
    header = taken_apart(read_text(check, str(check)), str(check)).header
    table = csv.read(check, columns_for(calibrated, header))
    found = verify(calibrated, table, aligned)
    tested = () if limit is None else length_errors(found.deviations, table, limit)
    for remark in [*_remarks(calibrated, table), *([found.mistake] if found.mistake else [])]:
        echo(f"warning: {remark}", err=True)
    if as_json:
        echo(summary.as_json(_figures(found) | _length_figures(tested)))
    else:
        echo("\n".join([_text(found, calibrated.degrees_of_freedom()), *_length_text(tested)]))
    if wanted is None:
        return 0
    return wanted.exit_code(_Ratio(_largest(tested)) if wanted.figure == "mpe_ratio" else found)


def _remarks(result: Result, check: Table) -> list[str]:
    """Return what the reader has to know of the file, the result and the uncertainties."""
    remarks = [*check.warnings]
    if "sigma" not in check:
        remarks.append("no column 'sigma_mm': U does not contain the uncertainty of the check")
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


@dataclass(frozen=True)
class _Ratio:
    """What `--require "mpe_ratio <= 1"` reads."""

    mpe_ratio: float


def _largest(tested: Sequence[LengthError]) -> float:
    from metrocli.uncertainty.length_errors import ratio

    return ratio(tested)


def _length_figures(tested: Sequence[LengthError]) -> dict[str, Any]:
    if not tested:
        return {}
    rows = [
        {
            "length": one.name,
            "error": one.error,
            "unit": "mm",
            "mpe": one.permitted,
            "U": one.test,
            "conforms": one.conforms,
        }
        for one in tested
    ]
    return {"length_errors": rows, "mpe_ratio": _largest(tested)}


def _length_text(tested: Sequence[LengthError]) -> Iterator[str]:
    from metrocli.cli.columns import worst_rows
    from metrocli.uncertainty.length_errors import ASKED

    if not tested:
        return
    rows = [["length", "error [um]", "MPE [um]", "U [um]", "conforms"]]
    for one in sorted(tested, key=lambda one: -one.share):
        rows.append([one.name, *(f"{_um(value):.3f}" for value in (one.error, one.permitted, one.test)), one.conforms])
    yield ""
    yield from worst_rows(rows)
    yield "errors are indicated minus calibrated (ISO 10360-2:2009); U is that of the calibrated length, k = 2"
    yield f"largest (|error| + U) / MPE: {_largest(tested):.3g}, conforming up to 1 (ISO 14253-1)"
    if len(tested) < ASKED:
        complete = f"a test by ISO 10360-2:2009 has {ASKED}: five, three times, in seven positions"
        yield f"{len(tested)} lengths; {complete}"


def _um(length: float) -> float:
    from metrocli.units import find_unit

    return find_unit("um", "length").outside(length)


def _text(found: Verification, dof: float) -> str:
    from metrocli.cli.columns import worst_rows

    rows = [["point", "deviation [um]", "U [um]", "E_n"]]
    for one in sorted(found.deviations, key=lambda one: -one.en):
        rows.append([one.name, f"{_um(one.value):.3f}", f"{_um(one.expanded):.3f}", f"{one.en:.2f}"])
    lines = worst_rows(rows)
    if found.laid:
        lines.append("the points are laid onto the prediction by a shift and a turn (--aligned: as they are)")
    mean, rms, largest = (f"{_um(value):.4g} um" for value in (found.mean, found.rms, found.largest))
    lines.append(f"{len(found.deviations)} deviations: mean {mean}, rms {rms}, largest {largest}")
    if found.largest_k > 1.0:
        lines.append(
            f"the result has {dof:.3g} degrees of freedom: "
            f"U has the t factor, up to {found.largest_k:.3g} times that of many"
        )
    lines.append(f"inside U: {100 * found.inside:.3g} %, largest E_n {found.max_en:.2f}")
    return "\n".join(lines)
