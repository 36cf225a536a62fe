"""metrocli plot: a figure of a result as a file, or the names of its figures."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo


@click.command("plot", help="Write a figure of a result; without a name, list the figures that it can show.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.argument("name", required=False, metavar="[NAME]")
@click.option("--save", type=click.Path(path_type=Path), metavar="FILE", help="File to write: .svg, .pdf or .png.")
@click.option("--dark", is_flag=True, help="Light lines on a dark ground.")
@options.FORCE
@options.QUIET
def command(result: Path, name: str | None, save: Path | None, dark: bool, force: bool, quiet: bool) -> int:
    """Print the names, or write one figure (by default RESULT.NAME.svg beside the result) and print its path.

    A file that metrocli did not write is replaced with `force` only.
    """
    from tempfile import TemporaryDirectory

    from metrocli import plots
    from metrocli.errors import UsageError
    from metrocli.formats import hdf5
    from metrocli.formats.own_files import write_all

    found, _ = hdf5.read(result)
    if name is None:
        if save is not None:
            raise UsageError("--save needs the name of a figure; without a name and --save, plot lists them")
        names = plots.names_of(found)
        width = max(map(len, names), default=0)
        for one in names:
            echo(f"{one:{width}}  {plots.FIGURES[one].summary}")
        return 0
    path = save or result.with_name(f"{result.stem}.{name}.svg")
    plots.check(found, name, path)
    with TemporaryDirectory() as folder:
        drawn = Path(folder) / "figure"
        plots.save(found, name, drawn, path.suffix, dark)
        data = drawn.read_bytes()
    for written in write_all({path: data}, force):
        Console(quiet).print(str(written))
    return 0
