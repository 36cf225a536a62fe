"""The small version of `python -m benchmarks pipeline`: an independent account of what has to run."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import pipeline


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, straight_line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_random_changes_run_what_has_to_run() -> None:
    assert pipeline.changes(12, seed=1) == (0, 0, 0)


def test_damaged_bits_are_not_believed_and_healed() -> None:
    assert pipeline.damages(6, seed=1)[:2] == (0, 0)


@pytest.mark.slow
def test_the_account_sees_a_lie(monkeypatch: pytest.MonkeyPatch) -> None:
    """If neither jobs nor inputs counted, results would be wrongly up to date."""
    monkeypatch.setattr("metrocli.project.fingerprint.changed_inputs", lambda *arguments: [])
    monkeypatch.setattr("metrocli.project.fingerprint.of_job", lambda job: "any")
    assert pipeline.changes(8, seed=1)[0] > 0
