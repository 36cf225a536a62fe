"""Results that are looked at for their numbers: each that is not fit for use is reported beside them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from metrocli.cli.console import echo

if TYPE_CHECKING:
    from metrocli.record import Record
    from metrocli.result import Result


def opened_result(file: Path) -> tuple[Result, Record]:
    """Return a result and its record; print to stderr why it is not fit for use, if it is not."""
    from metrocli.formats import hdf5

    result, record = hdf5.read(file)
    print_reasons(file, record)
    return result, record


def print_reasons(file: Path, record: Record) -> None:
    """Print to stderr why a result is not fit for use."""
    for reason in record.reasons:
        echo(f"warning: {file} is not fit for use: {reason}", err=True)
