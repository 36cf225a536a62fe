"""metrocli export: a result in the formats of other programs and of machine controls."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import Console, print_files
from metrocli.errors import Fault, InputError, UsageError
from metrocli.exports import FORMATS, WITHIN, export
from metrocli.table import Table

_NOTE = re.compile(r"^(?:#|%|<!--) note: (.*?)(?: -->)?$", re.MULTILINE)
_HEAD = 1000
"""Length of the part of a file that has notes"""
SUMMARIES = "; ".join(f"{name}, {form.summary}" for name, form in FORMATS.items())


@click.command("export", help="Write a result in another format and print the paths of the files.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.option("--to", "form", required=True, type=click.Choice(list(FORMATS)), help=f"Format to write: {SUMMARIES}.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder to write to (default: beside the result)."
)
@click.option(
    "--within",
    metavar="LENGTH",
    help=f"Cameras: largest difference where a format can only approach the lens; default '{WITHIN} px'.",
)
@options.ACCEPT
@options.WRITES
def command(
    result: Path,
    form: str,
    out: Path | None,
    within: str | None,
    accept_doubtful: bool,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Write the files of a format: as NAME into the given folder, else as RESULT.NAME beside the result.

    Raises InputError if the result is not fit for use, unless that is accepted; the files then state it. Files that
    metrocli did not write are replaced with `force` only, inputs of the result never.
    """
    from metrocli.formats import csv, hdf5
    from metrocli.formats.own_files import inside, refuse_inputs, write_all

    stored, record = hdf5.read(result)
    if record.reasons and not accept_doubtful:
        hint = "correct its job and run it again, or export it as it is by --accept-doubtful"
        reasons = "; ".join(record.reasons)
        raise InputError([Fault(f"not fit for use ({record.status}): {reasons}", str(result), hint=hint)])
    stored = replace(stored, doubts=record.reasons)
    inputs = (result, *record.files(result))
    if record.job_file:  # messages name it from the working folder, the result from its own
        record = replace(record, job_file=Path(os.path.relpath(result.parent / record.job_file)).as_posix())
    from metrocli.project.provenance.comparison import with_standards

    record = with_standards(result, record)
    contents = {}
    for name, content in export(form, stored, record, _pixels(form, within)).items():
        path = inside(out, name) if out is not None else inside(result.parent, f"{result.stem}.{name}")
        text = csv.to_text(content) if isinstance(content, Table) else content
        contents[path] = text.encode()
        for note in _NOTE.findall(text, 0, _HEAD):
            Console(quiet).warning(f"{path.name}: {note}")
    refuse_inputs(contents, inputs)
    return print_files(write_all(contents, force), as_json, quiet, status=record.status)


def _pixels(form: str, within: str | None) -> float:
    """Return the largest difference that is allowed; raises UsageError for a text without pixels."""
    from metrocli.units import QuantityError, parse_quantity

    if within is None:
        return WITHIN
    if not FORMATS[form].nearest:
        raise UsageError(f"--to {form} takes no --within: it is for cameras")
    try:
        return parse_quantity(within, "pixel")
    except QuantityError as error:
        raise UsageError(f"--within: {error}; write e.g. '{WITHIN} px'") from error
