"""A plan in files: its tables, what the measurement is made with, and plan.json as its summary."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats import csv
from metrocli.formats.aside import written_aside
from metrocli.plan import Plan
from metrocli.table import Table

SUMMARY = "plan.json"


def files_of(plan: Plan) -> dict[str, Table | str]:
    """Return all files of a plan but its summary, by name."""
    return {**{f"{name}.csv": table for name, table in plan.tables.items()}, **plan.files}


def refuse_foreign(folder: Path, force: bool) -> None:
    """Raise InputError where a folder holds files that are not those of an earlier plan, unless forced."""
    if force or not folder.exists() or (folder / SUMMARY).is_file():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        message = "the folder holds something else than a plan"
        raise InputError([Fault(message, str(folder), hint="name another one with --out, or use --force")])


def write(files: Mapping[str, Table | str], summary: str, folder: Path) -> Iterator[Path]:
    """Write the files of a plan and its summary into a folder, and give each path when it is there.

    Files of an earlier plan that this one has not are removed first: a program left over would be run.
    """
    for old in _earlier(folder) - files.keys():
        (folder / old).unlink(missing_ok=True)
    for name, content in {**files, SUMMARY: summary + "\n"}.items():
        path = folder / name
        if isinstance(content, Table):
            csv.write(path, content)
        else:
            with written_aside(path) as aside:
                aside.write_text(content, encoding="utf-8", newline="\n")
        yield path


def _earlier(folder: Path) -> set[str]:
    """Return the names of the files that the plan in a folder wrote; none where there is no plan."""
    try:
        listed = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["files"]
        return {Path(name).name for name in listed} - {SUMMARY}
    except (OSError, ValueError, KeyError, TypeError):
        return set()
