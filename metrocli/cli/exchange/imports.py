"""metrocli import: files of instruments and other programs, as the CSV that jobs read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo, print_files
from metrocli.errors import Fault, InputError, UsageError
from metrocli.imports import FORMATS, ImportOptions, imported
from metrocli.imports.lines import NOTE, TextLines

SUMMARIES = "; ".join(f"{name}, {form.summary}" for name, form in FORMATS.items())

if TYPE_CHECKING:
    from metrocli.nodes import Node

_FIRST = 10
"""Lines of a file that may be notes"""


@click.command("import", help="Write a file of an instrument as CSV that jobs read, and print the paths of the files.")
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE", nargs=-1, required=True)
@click.option(
    "--from",
    "form",
    type=click.Choice(list(FORMATS)),
    help=f"Its format: {SUMMARIES}. With --map it is columns; without both a mapping for the file is printed.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder to write to (default: beside the file)."
)
@click.option(
    "--map",
    "mapping",
    type=click.Path(path_type=Path),
    metavar="MAP.yaml",
    help="Column, unit and sign of each quantity.",
)
@click.option("--unit", default="", metavar="UNIT", help="Unit of lengths, where the file does not state it.")
@options.WRITES
def command(
    files: tuple[Path, ...],
    form: str | None,
    out: Path | None,
    mapping: Path | None,
    unit: str,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Write the CSV files of a file into a folder; of cameras, several files may state one rig.

    Raises InputError that lists all faults of the file with their rows, and for files there that metrocli did not write
    unless forced.
    """
    from metrocli.formats.own_files import inside, write_all
    from metrocli.project import yaml_text

    root, file = None, files[0]
    if mapping is not None:
        root = yaml_text.parse(yaml_text.read_text(mapping, str(mapping)), str(mapping), mapping.parent)
    lines = TextLines(str(file), _text(file, root).split("\n"))
    if form is None and root is not None:
        form = "columns"
    if form is None:
        from metrocli.imports.proposed_mapping import format_of, must_be_read, proposed

        if known := format_of(lines):
            raise UsageError(f"{file} has the format {known}: write metrocli import {file} --from {known}")
        must_be_read(lines)
        echo(proposed(lines))
        return 0
    others = tuple(TextLines(str(path), _text(path, root).split("\n")) for path in files[1:])
    texts = imported(form, lines, ImportOptions(root, unit, others))
    folder = file.parent if out is None else out
    for name in texts:
        for path in files:
            if inside(folder, name).resolve() == path.resolve():
                hint = "give a folder: --out DIR"
                raise InputError([Fault(f"would overwrite {path}, the file it reads", str(path), hint=hint)])
    written = list(write_all({inside(folder, name): text.encode() for name, text in texts.items()}, force))
    console = Console(quiet)
    for name, text in texts.items():
        notes = [line.removeprefix(NOTE) for line in text.splitlines()[:_FIRST] if line.startswith(NOTE)]
        for note in notes:
            console.warning(f"{name}: {note}")
    return print_files(written, as_json, quiet, status="ok")


def _text(file: Path, root: Node | None) -> str:
    """Return the text of a file in the encoding that its mapping names; UTF-8 without one."""
    from metrocli.formats.csv_text import read_text

    node = root.get("encoding") if root is not None else None
    if node is None or node.text in ("", "utf-8"):
        return read_text(file, str(file))
    from metrocli.formats.file_bytes import read_bytes

    try:
        text = read_bytes(file, "a file of an instrument", str(file)).data.decode(node.text)
    except (UnicodeDecodeError, LookupError) as error:
        raise InputError([node.fault(f"the file cannot be read in the encoding '{node.text}'", str(error))]) from error
    return text.lstrip("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
