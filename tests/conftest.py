"""Fixtures that all tests share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from metrocli import tasks

READINGS = "point,x_mm,y_um\na,0,1000\nb,1000,2000\nc,2000,3100\nd,3000,3900\n"
JOB = "metrocli: 1\njob: straight-line\ninputs: {readings: readings.csv}\nnoise: 0.1 mm\n"


@pytest.fixture
def straight_line(monkeypatch: pytest.MonkeyPatch) -> str:
    """Add the kind of job that the tests of the house use."""
    from straight_line import KIND

    monkeypatch.setitem(tasks.KINDS, KIND.name, KIND)
    return KIND.name


@dataclass(frozen=True)
class Ran:
    """What a command line did."""

    code: int
    out: str
    err: str


@pytest.fixture
def metrocli(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Carry out a command line in this process."""
    from metrocli.cli.commands import run

    def call(*arguments: object) -> Ran:
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Ran(code, captured.out, captured.err)

    return call


@pytest.fixture
def job(tmp_path: Path, straight_line: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a job that has no faults, and its readings; it is the working folder."""
    (tmp_path / "readings.csv").write_text(READINGS)
    (tmp_path / "line.yaml").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    return Path("line.yaml")
