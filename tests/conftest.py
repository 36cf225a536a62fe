"""Fixtures that all tests share."""

from __future__ import annotations

import gc
import os
import pickle
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from metrocli import tasks

# The outcome of the suite depends on the change alone. More and new draws: HYPOTHESIS_PROFILE=default, and `make fuzz`.
settings.register_profile("repeatable", derandomize=True, max_examples=25)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# Searching for cycles would take most of the time in which the laws parse all modules.
gc.set_threshold(100_000, 20, 100)

LONGEST = 8.0
"""CPU seconds of a test from which it is to be marked slow"""
READINGS = "point,x_mm,y_um\na,0,1000\nb,1000,2000\nc,2000,3100\nd,3000,3900\n"
JOB = "metrocli: 1\njob: straight-line\ninputs: {readings: readings.csv}\nnoise: 0.1 mm\n"


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_disks() -> Iterator[None]:
    """Leave files in the memory of the system: no test here ends its power."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture
def straight_line(monkeypatch: pytest.MonkeyPatch) -> str:
    """Add the kind of job that the tests of the house use."""
    from straight_line import KIND

    monkeypatch.setitem(tasks.KINDS, KIND.name, KIND)
    return KIND.name


_DRAWN: dict[object, Any] = {}


@pytest.fixture
def each_figure_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the figure of some data in pages once: most tests of pages are of the words beside it."""
    from metrocli.report import pictures

    plain = pictures._figure

    def figure(name: str, data: Any) -> Any:
        key = name, pictures.LARGEST, pickle.dumps(data)
        if key not in _DRAWN:
            _DRAWN[key] = plain(name, data)
        return _DRAWN[key]

    monkeypatch.setattr(pictures, "_figure", figure)


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


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the cases of a test that are `alike` as slow, but for the first that is quick."""
    begun = set[str]()
    for item in items:
        name = item.nodeid.partition("[")[0]
        if item.get_closest_marker("alike") and not item.get_closest_marker("slow"):
            if name in begun:
                item.add_marker("slow")
            begun.add(name)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Note the CPU seconds of a test beside its outcome."""
    before = time.process_time()
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu", time.process_time() - before))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List tests that take long and are not marked slow."""
    for report in terminalreporter.getreports("passed"):
        seconds = dict(report.user_properties).get("cpu", 0.0)
        if report.when == "call" and "slow" not in report.keywords and seconds > LONGEST:
            terminalreporter.write_line(f"{report.nodeid} took {seconds:.0f} s of CPU: shorten it, or mark it slow")
