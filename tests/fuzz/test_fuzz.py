"""The small version of `make fuzz`."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from benchmarks import fuzz
from metrocli.cli.commands import commands

SMALL = ("gauge-block", "ball-cube")


@pytest.mark.slow
def test_no_mutated_project_ends_in_a_traceback() -> None:
    assert fuzz.campaign(60, seed=18, most=12, names=SMALL) == []


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["traceback", "endless", "memory"])
def test_the_campaign_sees_a_fault(fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that raises, that never ends, or that takes all memory is a finding."""

    def planted(*words: object, **options: object) -> int:
        if fault == "traceback":
            raise ZeroDivisionError("a planted defect")
        if fault == "endless":
            os.kill(os.getpid(), signal.SIGXCPU)
        assert b"x" * 1_000_000_000
        return 0

    project = fuzz.prepared(tmp_path, ("gauge-block",))[0]
    monkeypatch.setattr(commands, "main", planted)
    # The child inherits what its parent has taken: the limit lies well above a long run of tests.
    monkeypatch.setattr(fuzz, "MOST_BYTES", 1_000_000_000)
    wanted = {"traceback": "exit code 1", "endless": "more than 20 s", "memory": " GB"}[fault]
    assert fuzz.case(0, 0, [project], tmp_path / "mutated").fault.endswith(wanted)
