"""metrocli plot: a figure of a result as a file, or the names of its figures, and what a result is compared with."""

from __future__ import annotations

import json
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo, echo_json, print_files
from metrocli.cli.shell.choices import figures, offering
from metrocli.errors import Fault, InputError, UsageError
from metrocli.project import DIAGNOSIS
from metrocli.record import DONE

if TYPE_CHECKING:
    from metrocli.plots.context import LineageFile, ResultContext
    from metrocli.project.provenance.lineage import Origin
    from metrocli.record import Record
    from metrocli.report.html import PrintedDiagnosis
    from metrocli.result import Result

_FILE = click.Path(path_type=Path)


@click.command("plot", help="Write a figure of a result; without a name, list the figures that it can show.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.argument("name", required=False, metavar="[NAME]", shell_complete=offering(figures))
@click.option("--save", type=click.Path(path_type=Path), metavar="FILE", help="File to write: .svg, .pdf or .png.")
@click.option("--dark", is_flag=True, help="Light lines on a dark ground.")
@click.option("--before", type=_FILE, metavar="OTHER.h5", help="Result of the job without its extension.")
@click.option("--diagnosis", type=_FILE, metavar="FILE.json", help="Output of `metrocli diagnose --json`.")
@options.WRITES
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
    context = context_of(result, diagnosis, flags["before"])
    if name is None:
        if save is not None:
            raise UsageError("--save needs the name of a figure; without a name and --save, plot lists them")
        return _print_names(stored, context, as_json)
    path = save or result.with_name(f"{result.stem}.{name}.svg")
    data = _figure_data(stored, name, path, context, flags["dark"])
    refuse_inputs([path], (result, *record.files(result)))
    return print_files(write_all({path: data}, flags["force"]), as_json, flags["quiet"])


def _print_names(result: Result, context: ResultContext, as_json: bool) -> int:
    """Print the names of the figures that a result can show; return 0."""
    from metrocli import plots

    summaries = {figure: plots.FIGURES[figure].summary for figure in plots.names_of(result, context)}
    if as_json:
        echo_json({"figures": summaries})
        return 0
    width = max(map(len, summaries), default=0)
    # one table, whose columns stay aligned where the terminal is narrow
    echo("\n".join(f"{name:{width}}  {text}" for name, text in summaries.items()))
    return 0


def _figure_data(result: Result, name: str, path: Path, context: ResultContext, dark: bool) -> bytes:
    """Return the figure for a path, in the format that its ending names."""
    from metrocli import plots

    plots.check(result, name, path, context)
    with TemporaryDirectory() as folder:
        figure = Path(folder) / "figure"
        plots.save(result, name, figure, path.suffix, dark, context)
        return figure.read_bytes()


_DIAGNOSE = "write it by: metrocli diagnose JOB.yaml --json > FILE.json"
_STEP = re.compile(r"(.*)\.step([0-9]+)")


def diagnosis_of(result: Path, given: Path | None, record: Record) -> PrintedDiagnosis | None:
    """Return the diagnosis that is given, else the one beside the result; raise InputError if it cannot be read."""
    path = given or result.with_suffix(DIAGNOSIS)
    if given is None and not path.is_file():
        return None
    # not before: this loads the search for effects
    from metrocli.project.fingerprint import of_diagnosed
    from metrocli.report.html import PrintedDiagnosis

    try:
        data: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError([Fault(f"cannot be read: {error.strerror}", str(path), hint=_DIAGNOSE)]) from error
    except ValueError:
        data = None
    if not isinstance(data, dict) or "verdict" not in data:
        raise InputError([Fault("this is not the output of metrocli diagnose --json", str(path), hint=_DIAGNOSE)])
    return PrintedDiagnosis(data, str(path), data.get("of") == of_diagnosed(record.job_text, record.inputs))


def context_of(result: Path, diagnosis: PrintedDiagnosis | None, before: Path | None = None) -> ResultContext:
    """Return what figures show beside a result: the diagnosis if it is of this job, the earlier result, the lineage.

    Without `before` the earlier result is NAME.h5 beside NAME.extended.h5, if it can be read.
    """
    from metrocli.plots.context import ResultContext
    from metrocli.project.provenance.lineage import shortened, trace

    data = diagnosis.data if diagnosis is not None and diagnosis.is_current else None
    return ResultContext(data, _before(result, before), tuple(_nodes(shortened(trace(result)))))


def _before(result: Path, given: Path | None) -> Result | None:
    from metrocli.formats import hdf5

    path = given or _earlier(result)
    if path is None or (given is None and not path.is_file()):
        return None
    try:
        return hdf5.read(path)[0]
    except InputError:
        if given is not None:
            raise
        return None


def _earlier(result: Path) -> Path | None:
    """Return the result that diagnose extended, by the names that it gives."""
    if result.stem.endswith(".extended"):
        return result.with_name(f"{result.stem.removesuffix('.extended')}.h5")
    step = _STEP.fullmatch(result.stem)
    if step is None:
        return None
    number = int(step[2]) - 1
    return result.with_name(f"{step[1]}.step{number}.h5" if number else f"{step[1]}.h5")


def _nodes(origin: Origin) -> list[LineageFile]:
    """Return the files of a lineage, each once, by their paths from the folder above that of the result."""
    from metrocli.plots.context import LineageFile
    from metrocli.project.provenance.lineage import AS_READ, files_of, name_from

    home = origin.path.parent.parent
    return [
        LineageFile(
            name_from(home, file),
            file.label.kind if file.label else "",
            file.state == AS_READ and (file.label is None or file.label.status == DONE),
            tuple(dict.fromkeys(name_from(home, below) for below in file.origins)),
        )
        for file in files_of(origin)
    ]
