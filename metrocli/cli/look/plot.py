"""metrocli plot: a figure of a result as a file, or the names of its figures."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options


@click.command("plot", help="Write a figure of a result; without a name, list the figures that it can show.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.argument("name", required=False, metavar="[NAME]")
@click.option("--save", type=click.Path(path_type=Path), metavar="FILE", help="File to write: .svg, .pdf or .png.")
@click.option("--dark", is_flag=True, help="Light lines on a dark ground.")
@options.QUIET
def command(result: Path, name: str | None, save: Path | None, dark: bool, quiet: bool) -> int:
    """Print the names, or write one figure (by default RESULT.NAME.svg beside the result) and print its path."""
    from metrocli import plots
    from metrocli.errors import UsageError
    from metrocli.formats import aside, hdf5

    found, _ = hdf5.read(result)
    if name is None:
        if save is not None:
            raise UsageError("--save needs the name of a figure; without a name and --save, plot lists them")
        names = plots.names_of(found)
        width = max(map(len, names), default=0)
        for one in names:
            click.echo(f"{one:{width}}  {plots.FIGURES[one].summary}")
        return 0
    path = save or result.with_name(f"{result.stem}.{name}.svg")
    plots.check(found, name, path)
    with aside.written_aside(path) as temporary:
        plots.save(found, name, temporary, path.suffix, dark)
    if not quiet:
        click.echo(path)
    return 0
