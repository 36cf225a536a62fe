"""Jobs of report-uncertainty, written and carried out as a user would."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from metrocli.cli.commands import run
from metrocli.formats import hdf5
from metrocli.record import Record
from metrocli.result import Result


@dataclass(frozen=True)
class Ran:
    """What came out of a job."""

    code: int
    read: tuple[Result, Record] | None
    path: Path

    @property
    def result(self) -> Result | None:
        return self.read and self.read[0]

    def details(self, name: str) -> dict[str, Any]:
        """Everything that the summary says of a measurand."""
        from metrocli.cli.summary import summary

        assert self.read is not None
        return dict(summary(*self.read, self.path)["estimates"][name])


def write(folder: Path, job: dict[str, Any], name: str = "job") -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(
        yaml.safe_dump({"metrocli": 1, "job": "report-uncertainty", "output": f"{name}.h5", **job}, sort_keys=False)
    )
    return path


def carry_out(folder: Path, job: dict[str, Any], name: str = "job", *options: str) -> Ran:
    """Run a job quietly in this process."""
    path = write(folder, job, name)
    code = run(["report-uncertainty", str(path), "--quiet", *options])
    output = folder / f"{name}.h5"
    return Ran(code, hdf5.read(output) if output.is_file() else None, output)
