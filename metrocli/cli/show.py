"""metrocli show: a result on the terminal."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from metrocli.cli import options


@click.command("show", help="A result on the terminal.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.option("--table", "name", metavar="NAME", help="Print one table, whole, as CSV.")
@click.option(
    "--distance", nargs=2, metavar="POINT POINT", help="Print the distance of two points with its uncertainty."
)
@click.option(
    "--at", nargs=3, metavar="X Y Z", help="Print the machine error at a point, such as '10 mm' '0 mm' '-32.5 mm'."
)
@options.JSON
def command(
    result: Path, name: str | None, distance: tuple[str, str] | None, at: tuple[str, str, str] | None, as_json: bool
) -> int:
    """Print a result as its job did, one of its tables, the distance of two points, or the machine error at one."""
    from metrocli.cli import summary, terminal
    from metrocli.errors import UsageError
    from metrocli.formats import csv, hdf5
    from metrocli.words import suggestion

    found, record = hdf5.read(result)
    if name is not None:
        if name not in found.tables:
            raise UsageError(f"{result} has no table '{name}'; {suggestion(name, found.tables)}")
        table = found.tables[name]
        click.echo(summary.json_of_table(table) if as_json else csv.to_text(table), nl=as_json)
        return 0
    if distance is not None:
        from metrocli.tasks.multilaterate.distance import distance as between

        estimate = between(found, *distance)
        click.echo(summary.as_json(asdict(estimate)) if as_json else terminal.estimates_text((estimate,)))
        return 0
    if at is not None:
        from metrocli.tasks.selfcal_grid.point import error_at

        estimates = error_at(found, at)
        as_text = summary.as_json([asdict(one) for one in estimates]) if as_json else terminal.estimates_text(estimates)
        click.echo(as_text)
        return 0
    if as_json:
        click.echo(summary.json_of(found, record, result))
        return 0
    click.echo(terminal.result_text(found, record, result))
    click.echo(f"tables: {', '.join(found.tables) or 'none'}")
    for line in found.warnings:
        click.echo(f"warning: {line}", err=True)
    return 0
