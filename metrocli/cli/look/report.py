"""metrocli report: a result or a project as a self-contained HTML page."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import click

from metrocli.cli import options
from metrocli.cli.console import Console, print_files
from metrocli.cli.look.plot import context_of, diagnosis_of
from metrocli.errors import InputError, UsageError
from metrocli.project import PROJECT_FILE

if TYPE_CHECKING:
    from metrocli.project.staleness import Staleness
    from metrocli.project.steps import ProjectStep
    from metrocli.record import Record
    from metrocli.report.html import Html

Counter = Callable[[int, int], None]
"""Takes how many of how many parts are done"""


@click.command("report", help="Write a result, or a project with all its results, as self-contained HTML pages.")
@click.argument("place", type=click.Path(path_type=Path), metavar="RESULT.h5|PROJECT")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="Page to write (default: beside the result)."
)
@click.option(
    "--diagnosis", type=click.Path(path_type=Path), metavar="FILE.json", help="Output of `metrocli diagnose --json`."
)
@click.option("--pdf", is_flag=True, help="Write each page as PDF, too; needs Chromium or Chrome.")
@options.UNITS
@options.WRITES
def command(
    place: Path,
    out: Path | None,
    diagnosis: Path | None,
    pdf: bool,
    units: str,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Write NAME.html beside a result, or report/index.html and the page of each result for a project.

    A file that metrocli did not write is replaced with `force` only.
    """
    from metrocli.formats.own_files import refuse_inputs, write_all

    project = place.is_dir() or place.name == PROJECT_FILE
    if project and diagnosis is not None:
        raise UsageError("--diagnosis is for the page of one result; beside NAME.h5, NAME.diagnosis.json is found")
    console = Console(quiet or as_json)
    if project:
        console.doing("making the pages")
        pages = _project(place, out, units, console.count)
    else:
        console.doing("making the page")
        pages = {out or place.with_suffix(".html"): _page(place, diagnosis, Path(), units)}
    files = {path: text.encode() for path, text in pages.items()}
    if pdf:
        console.doing("printing the pages as PDF")
        files |= _printed(pages, console.count)
    refuse_inputs(files, _inputs(place, project))
    return print_files(write_all(files, force), as_json, quiet)


def _inputs(place: Path, project: bool) -> Iterator[Path]:
    """Yield what the jobs of a project read, or the job of a result."""
    from metrocli.formats import hdf5
    from metrocli.project.steps import load_project

    if not project:
        yield from (place, *hdf5.read(place)[1].files(place))
        return
    for step in load_project(place, accept_doubtful=True):
        yield from (*step.job.stated_in, *step.job.files, step.job.output)


def _printed(pages: Mapping[Path, str], done: Counter) -> dict[Path, bytes]:
    """Return each page as PDF, beside it."""
    from metrocli.report.pdf import printed

    files = {}
    for count, (path, text) in enumerate(pages.items()):
        done(count, len(pages))
        files[path.with_suffix(".pdf")] = printed(text)
    return files


def _page(result: Path, given: Path | None, home: Path, units: str, name: str = "") -> str:
    """Return the page of a result; its files and its job, if that has no `name`, are named from the folder `home`.

    Estimates and tables are in `units`; figures have theirs.
    """
    from metrocli.cli import columns
    from metrocli.cli.look.inches import in_units
    from metrocli.formats import hdf5
    from metrocli.project.provenance.comparison import with_standards
    from metrocli.report.html import Content
    from metrocli.report.result_page import result_page

    stored, record = hdf5.read(result)
    stated = in_units(stored, units)
    tables = {}
    for shown in stated.shown:
        if shown.name in stated.tables and len(stated.tables[shown.name]):
            tables[shown.name] = columns.table_text(shown.of(stated.tables[shown.name]))
    diagnosis = diagnosis_of(result, given, record)
    job = name or (_from(home, result.parent / record.job_file) if record.job_file else "JOB.yaml")
    record = with_standards(result, record)
    return result_page(
        Content(stored, record, _from(home, result), tables, diagnosis, job, context_of(result, diagnosis), stated)
    )


def _project(place: Path, out: Path | None, units: str, done: Counter) -> dict[Path, str]:
    """Return the page that leads to those of all results that exist, and these."""
    from metrocli.project.staleness import states
    from metrocli.project.steps import load_project, name_of_project, project_file
    from metrocli.report.project_page import JobEntry, project_page

    file = project_file(place)
    index = out or file.parent / "report" / "index.html"
    current, pages = list(states(load_project(place))), dict[Path, str]()
    outputs = [state.step.job.output for state in current]
    made = {output.resolve() for output in outputs}
    entries = []
    for count, state in enumerate(current):
        done(count, len(current))
        step, page, verdict = state.step, "", ""
        with suppress(InputError):  # a result that is absent or damaged has no page; its state names the reason
            text = _page(step.job.output, None, file.parent, units, step.name)
            page = _page_name(step.job.output, outputs, file.parent)
            pages[index.parent / page] = text
            verdict = _verdict(step.job.output, state.record)
        status = state.record.status if state.record is not None else ""
        own = tuple(_files(step, made, file.parent))
        title = step.job.heading.title
        decided = state.record.conformity if state.record is not None else ""
        entries.append(
            JobEntry(step.name, step.job.kind, title, status, state.reason, step.needs, own, page, decided, verdict)
        )
    name = name_of_project(place) or file.parent.resolve().name
    return {index: project_page(name, entries, list(_charts(current, file.parent))), **pages}


def _verdict(result: Path, record: Record | None) -> str:
    """Return the verdict of the diagnosis beside a result, or "" without one of this result."""
    diagnosis = None if record is None else diagnosis_of(result, None, record)
    return str(diagnosis.data["verdict"]) if diagnosis is not None and diagnosis.is_current else ""


def _charts(judged: Sequence[Staleness], home: Path) -> Iterator[Html]:
    """Yield the control charts of each job with a list of parts."""
    from metrocli.project.provenance.comparison import table_of
    from metrocli.report.pictures import control_charts

    several = [state for state in judged if state.step.job.options.part is not None and state.label is not None]
    for file, states in groupby(
        sorted(several, key=lambda state: str(state.step.job.file)), lambda state: state.step.job.file
    ):
        drawn = control_charts(_from(home, file), table_of(states))
        if drawn:
            yield drawn


def _page_name(output: Path, outputs: Sequence[Path], home: Path) -> str:
    """Return the name of the page of a result: that of its file, with its folders where others have the same name."""
    alike = [other for other in outputs if other.stem == output.stem]
    if len(alike) == 1 and output.stem != "index":
        return f"{output.stem}.html"
    return f"{_from(home, output.with_suffix('')).replace('/', '-')}.html"


def _files(step: ProjectStep, made: set[Path], home: Path) -> list[str]:
    """Return the inputs that no job of the project writes, from the folder `home`; several of one key as one."""
    names = []
    for item in step.job.inputs:
        paths = [path for path in item.paths if path.resolve() not in made]
        if len(paths) == 1:
            names.append(_from(home, paths[0]))
        elif paths:
            names.append(f"{_from(home, paths[0].parent)}/ ({len(paths)} files)")
    return names


def _from(home: Path, path: Path) -> str:
    return Path(os.path.relpath(path, home)).as_posix()
