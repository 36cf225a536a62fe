"""metrocli export: a result in the formats of other programs and of machine controls."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import print_files
from metrocli.errors import Fault, InputError
from metrocli.exports import FORMATS, export
from metrocli.table import Table

SUMMARIES = "; ".join(f"{name}, {form.summary}" for name, form in FORMATS.items())


@click.command("export", help="Write a result in another format and print the paths of the files.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.option("--to", "form", required=True, type=click.Choice(list(FORMATS)), help=f"Format to write: {SUMMARIES}.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder to write to (default: beside the result)."
)
@options.ACCEPT
@options.FORCE
@options.JSON
@options.QUIET
def command(
    result: Path, form: str, out: Path | None, accept_doubtful: bool, force: bool, as_json: bool, quiet: bool
) -> int:
    """Write the files of a format: as NAME into the given folder, else as RESULT.NAME beside the result.

    Raises InputError if the result is not fit for use, unless that is accepted; the files then state it. Inputs of the
    result, which an import may have written, and files that metrocli did not write are replaced with `force` only.
    """
    from metrocli.formats import csv, hdf5
    from metrocli.formats.own_files import inside, write_all

    found, record = hdf5.read(result)
    if record.reasons and not accept_doubtful:
        hint = "correct its job and run it again, or export it as it is by --accept-doubtful"
        reasons = "; ".join(record.reasons)
        raise InputError([Fault(f"not fit for use ({record.status}): {reasons}", str(result), hint=hint)])
    found = replace(found, doubts=record.reasons)
    folder_of_job = os.path.dirname(result.parent / record.job_file)
    inputs = {os.path.realpath(os.path.join(folder_of_job, one.path)) for one in record.inputs}
    if record.job_file:  # messages name it from the working folder, the result from its own
        record = replace(record, job_file=Path(os.path.relpath(result.parent / record.job_file)).as_posix())
    from metrocli.project.provenance.comparison import with_standards

    record = with_standards(result, record)
    contents = {}
    for name, content in export(form, found, record).items():
        path = inside(out, name) if out is not None else inside(result.parent, f"{result.stem}.{name}")
        contents[path] = (csv.to_text(content) if isinstance(content, Table) else content).encode()
    used = [str(path) for path in contents if os.path.realpath(path) in inputs]
    if used and not force:
        hint = "choose another folder, or use --force"
        raise InputError([Fault("the result is made from this file", path, hint=hint) for path in used])
    return print_files(write_all(contents, force), as_json, quiet, status=record.status)
