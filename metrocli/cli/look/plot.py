"""metrocli plot: a figure of a result as a file, or the names of its figures."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo, print_files
from metrocli.cli.look.beside import beside_of, diagnosis_of
from metrocli.cli.shell.choices import figures, offering
from metrocli.errors import Fault, InputError, UsageError

if TYPE_CHECKING:
    from metrocli.plots.beside import Beside
    from metrocli.result import Result

_FILE = click.Path(path_type=Path)


@click.command("plot", help="Write a figure of a result; without a name, list the figures that it can show.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.argument("name", required=False, metavar="[NAME]", shell_complete=offering(figures))
@click.option("--save", type=click.Path(path_type=Path), metavar="FILE", help="File to write: .svg, .pdf or .png.")
@click.option("--dark", is_flag=True, help="Light lines on a dark ground.")
@click.option("--before", type=_FILE, metavar="OTHER.h5", help="Result of the job without its extension.")
@click.option("--diagnosis", type=_FILE, metavar="FILE.json", help="Output of `metrocli diagnose --json`.")
@options.FORCE
@options.JSON
@options.QUIET
def command(result: Path, name: str | None, save: Path | None, as_json: bool, **flags: Any) -> int:
    """Print the names, or write one figure (by default RESULT.NAME.svg beside the result) and print its path.

    A file that metrocli did not write is replaced with `force` only.
    """
    from metrocli.formats import hdf5
    from metrocli.formats.own_files import refuse_inputs, write_all

    stored, record = hdf5.read(result)
    given = flags["diagnosis"]
    diagnosis = diagnosis_of(result, given, record)
    # one beside the result that is out of date is left out; one that was named would be missed
    if given is not None and diagnosis is not None and not diagnosis.is_current:
        hint = "diagnose the job of this result again"
        raise InputError([Fault("this is the diagnosis of another job, or of other inputs", str(given), hint=hint)])
    beside = beside_of(result, diagnosis, flags["before"])
    if name is None:
        if save is not None:
            raise UsageError("--save needs the name of a figure; without a name and --save, plot lists them")
        return _print_names(stored, beside, as_json)
    path = save or result.with_name(f"{result.stem}.{name}.svg")
    data = _figure_data(stored, name, path, beside, flags["dark"])
    refuse_inputs([path], (result, *record.files(result)))
    return print_files(write_all({path: data}, flags["force"]), as_json, flags["quiet"])


def _print_names(result: Result, beside: Beside, as_json: bool) -> int:
    """Print the names of the figures that a result can show; return 0."""
    from metrocli import plots

    summaries = {figure: plots.FIGURES[figure].summary for figure in plots.names_of(result, beside)}
    if as_json:
        from metrocli.cli.summary import as_json as json_text

        echo(json_text({"figures": summaries}))
        return 0
    width = max(map(len, summaries), default=0)
    # one table, whose columns stay aligned where the terminal is narrow
    echo("\n".join(f"{name:{width}}  {text}" for name, text in summaries.items()))
    return 0


def _figure_data(result: Result, name: str, path: Path, beside: Beside, dark: bool) -> bytes:
    """Return the figure for a path, in the format that its ending names."""
    from metrocli import plots

    plots.check(result, name, path, beside)
    with TemporaryDirectory() as folder:
        figure = Path(folder) / "figure"
        plots.save(result, name, figure, path.suffix, dark, beside)
        return figure.read_bytes()
