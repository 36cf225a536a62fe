"""metrocli verify: a result compared with independent measurements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo, echo_json
from metrocli.cli.look.opened import opened_result, require_option, requirement_of
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
@require_option("'max_en < 1' or 'inside >= 0.95'")
@options.JSON
def command(result: Path, check: Path, aligned: bool, mpe: str | None, require: str | None, as_json: bool) -> int:
    """Print the deviations, measured minus predicted; raises UsageError for a wrong condition."""
    from metrocli.formats import csv
    from metrocli.formats.csv_text import read_text, taken_apart
    from metrocli.uncertainty.length_errors import length_errors, permitted
    from metrocli.uncertainty.verification import columns_for, verify

    wanted = requirement_of(require, FIGURES if mpe else FIGURES[:2])
    limit = None if mpe is None else permitted(mpe)
    calibrated, _ = opened_result(result)
    header = taken_apart(read_text(check, str(check)), str(check)).header
    table = csv.read(check, columns_for(calibrated, header))
    verification = verify(calibrated, table, aligned)
    tested = () if limit is None else length_errors(verification.deviations, table, limit)
    for remark in [*_remarks(calibrated, table), *([verification.mistake] if verification.mistake else [])]:
        echo(f"warning: {remark}", err=True)
    if as_json:
        echo_json(_figures(verification) | _length_figures(tested))
    else:
        echo("\n".join([_text(verification, calibrated.degrees_of_freedom()), *_length_text(tested)]))
    if wanted is None:
        return 0
    return wanted.exit_code(_Ratio(_largest(tested)) if wanted.figure == "mpe_ratio" else verification)


def _remarks(result: Result, check: Table) -> list[str]:
    """Return what the reader has to know of the file, the result and the uncertainties."""
    remarks = [*check.warnings]
    if "sigma" not in check:
        remarks.append("no column 'sigma_mm': U does not contain the uncertainty of the check")
    names = sorted({name.split("/")[1] for name in result.tables if name.startswith("effects/")})
    if names and "mx" in check:
        remarks.append(f"the prediction does not contain the effects in the result: {', '.join(names)}")
    return remarks


def _figures(verification: Verification) -> dict[str, Any]:
    rows = []
    for deviation in verification.deviations:
        row = {
            "point": deviation.name,
            "deviation": deviation.value,
            "unit": "mm",
            "U": deviation.expanded,
            "en": deviation.en,
        }
        rows.append(row | ({"vector": deviation.vector} if deviation.vector else {}))
    names = ("mean", "rms", "largest", "inside", "max_en")
    return {"points": rows, **{name: getattr(verification, name) for name in names}}


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
            "length": length.name,
            "error": length.error,
            "unit": "mm",
            "mpe": length.permitted,
            "U": length.test,
            "conforms": length.conforms,
        }
        for length in tested
    ]
    return {"length_errors": rows, "mpe_ratio": _largest(tested)}


def _length_text(tested: Sequence[LengthError]) -> Iterator[str]:
    from metrocli.cli.columns import worst_rows
    from metrocli.uncertainty.length_errors import ASKED

    if not tested:
        return
    rows = [["length", "error [um]", "MPE [um]", "U [um]", "conforms"]]
    for length in sorted(tested, key=lambda length: -length.share):
        rows.append(
            [
                length.name,
                *(f"{_um(value):.3f}" for value in (length.error, length.permitted, length.test)),
                length.conforms,
            ]
        )
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


def _text(verification: Verification, dof: float) -> str:
    from metrocli.cli.columns import worst_rows

    rows = [["point", "deviation [um]", "U [um]", "E_n"]]
    for deviation in sorted(verification.deviations, key=lambda deviation: -deviation.en):
        rows.append(
            [deviation.name, f"{_um(deviation.value):.3f}", f"{_um(deviation.expanded):.3f}", f"{deviation.en:.2f}"]
        )
    lines = worst_rows(rows)
    if verification.laid:
        lines.append("the points are laid onto the prediction by a shift and a turn (--aligned: as they are)")
    mean, rms, largest = (
        f"{_um(value):.4g} um" for value in (verification.mean, verification.rms, verification.largest)
    )
    lines.append(f"{len(verification.deviations)} deviations: mean {mean}, rms {rms}, largest {largest}")
    if verification.largest_k > 1.0:
        lines.append(
            f"the result has {dof:.3g} degrees of freedom: "
            f"U has the t factor, up to {verification.largest_k:.3g} times that of many"
        )
    lines.append(f"inside U: {100 * verification.inside:.3g} %, largest E_n {verification.max_en:.2f}")
    return "\n".join(lines)
