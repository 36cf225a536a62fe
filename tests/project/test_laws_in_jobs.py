"""Which law stands in an extended job, and what the report states of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from metrocli.cli.commands import run
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.findings import Diagnosis
from metrocli.errors import UndeterminedError
from metrocli.project import diagnosed
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import JobFile, load


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> JobFile:
    """The sample without its own effect: a law is sought for what it leaves."""
    folder = tmp_path_factory.mktemp("hall") / "lab"
    assert run(["init", str(folder), "--sample", "laboratory-effects"]) == 0
    (folder / "metrocli.yaml").write_text("project: hall\njobs: [jobs/hall.yaml]\n")
    return load(folder / "jobs" / "hall.yaml")


@pytest.fixture(scope="module")
def found(hall: JobFile) -> Diagnosis:
    return carry_out(hall)


def report(found: Diagnosis, extended: diagnosed.Extended | None) -> str:
    return " ".join(of_diagnosis(found, extended).split())


def test_the_chosen_law_stands_in_the_job(hall: JobFile, found: Diagnosis) -> None:
    written = write_extended(hall, found, force=True)
    assert written is not None and written.law is found.law is not None
    assert "The extended job contains it." in report(found, written)
    assert "extended by the law" in report(found, written)


def test_where_the_job_cannot_be_adjusted_with_it_the_simpler_one_does(hall: JobFile, found: Diagnosis) -> None:
    """A law with each of its terms twice is undetermined."""
    assert found.law is not None
    twice = replace(found.law, **{key: 2 * getattr(found.law, key) for key in ("terms", "sizes", "stds")})
    found = replace(found, laws=(replace(found.law, chosen=False), twice))
    written = write_extended(hall, found, force=True)
    assert written is not None and written.law is found.laws[0]
    assert "a1:" in written.path.read_text() and "a2:" not in written.path.read_text()
    assert "the extended job contains the law of " in report(found, written)


def test_a_job_without_the_law_is_not_said_to_contain_it(
    hall: JobFile, found: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = UndeterminedError("the law is not determined")
    monkeypatch.setattr(diagnosed, "_refusal", lambda path, law: None if law is None else refused)
    written = write_extended(hall, found, force=True)
    assert written is None or (written.law is None and "define" not in written.path.read_text())
    assert "No extended job contains it." in report(found, written)
    assert "by the law" not in report(found, written)
