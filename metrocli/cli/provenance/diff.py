"""metrocli diff: what changed between two results, and which input or setting did."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from metrocli.cli import options
from metrocli.cli.console import echo, echo_json

if TYPE_CHECKING:
    from metrocli.project.provenance.comparison import Moved


@click.command("diff", help="Show which estimates moved between two results, and which inputs and settings changed.")
@click.argument("first", type=click.Path(path_type=Path), metavar="A.h5")
@click.argument("second", type=click.Path(path_type=Path), metavar="B.h5")
@options.JSON
def command(first: Path, second: Path, as_json: bool) -> int:
    """Print the differences, in standard uncertainties of the first result; return 0 whatever they are."""
    from metrocli.cli import columns
    from metrocli.project.provenance.comparison import between

    differences = between(first, second)
    if as_json:
        echo_json(asdict(differences))
        return 0
    if differences.same:
        echo("the results are the same, bit for bit")
    rows = [["estimate", "from", "to", "unit", "moved by"]]
    rows += [
        [m.name, _written(m, m.before), _written(m, m.after), m.unit, f"{m.stds:.3g} std"] for m in differences.moved
    ]
    if differences.moved:
        echo(columns.columns_text(rows))
    for heading, lines in (("", differences.only), ("setting ", differences.settings), ("", differences.inputs)):
        for line in lines:
            echo(f"{heading}{line}")
    if not differences.same and not (differences.moved or differences.only):
        echo("no estimate moved; tables or other figures differ")
    return 0


def _written(moved: Moved, value: float) -> str:
    """Return a value to the second digit of its uncertainty, or to ten digits without one."""
    from metrocli.units import rounded

    return rounded(value, moved.std)[0] if 0 < moved.std < math.inf else f"{value:.10g}"
