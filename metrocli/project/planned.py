"""A plan written to files: its tables, the files for the measurement (NC programs), and plan.json as its summary."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats import csv
from metrocli.formats.file_bytes import atomic_write
from metrocli.formats.own_files import inside
from metrocli.plan import Plan
from metrocli.table import Table

SUMMARY = "plan.json"


def files_of(plan: Plan) -> dict[str, Table | str]:
    """Return all files of a plan except its summary, by name."""
    return {**{f"{name}.csv": table for name, table in plan.tables.items()}, **plan.files}


def refuse_foreign(folder: Path, force: bool) -> None:
    """Raise InputError if a folder holds files but no earlier plan, unless forced."""
    if force or not folder.exists() or (folder / SUMMARY).is_file():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        message = "the folder is not empty and holds no plan"
        raise InputError([Fault(message, str(folder), hint="name another one with --out, or use --force")])


def write(files: Mapping[str, Table | str], summary: str, folder: Path) -> Iterator[Path]:
    """Write the files of a plan and its summary into a folder; yield each path once its file is written.

    Files of an earlier plan that this one does not have are removed first: somebody might run an old NC program.
    """
    for old in _earlier(folder) - files.keys():
        (folder / old).unlink(missing_ok=True)
    for name, content in {**files, SUMMARY: summary + "\n"}.items():
        path = inside(folder, name)
        if isinstance(content, Table):
            csv.write(path, content)
        else:
            with atomic_write(path) as aside:
                aside.write_text(content, encoding="utf-8", newline="\n")
        yield path


def _earlier(folder: Path) -> set[str]:
    """Return the names of the files that an earlier plan wrote into a folder; empty if there is no plan."""
    try:
        listed = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["files"]
        return {Path(name).name for name in listed} - {SUMMARY}
    except (OSError, ValueError, KeyError, TypeError):
        return set()
