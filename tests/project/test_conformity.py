"""A decision on a tolerance is a result: in the status, the exit code, pages, tables; it does not hide the result."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: report-uncertainty
quantities:
  d: {value: VALUE mm, std: 2 um}
measurands:
  D: {model: "d", unit: mm}
tolerance: {D: [19.98 mm, 20.02 mm]}
monte_carlo: {trials: 10000}
output: VALUE.h5
"""
USER = """metrocli: 1
job: report-uncertainty
inputs: {results: {part: 20.03.h5}}
quantities:
  D: {estimate: part.D}
measurands:
  half: {model: "D/2", unit: mm}
output: half.h5
"""


@pytest.fixture
def parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for value in ("20.00", "20.019", "20.03"):
        Path(f"{value}.yaml").write_text(JOB.replace("VALUE", value))


@pytest.mark.parametrize(
    ("value", "decision", "code", "words"),
    [
        ("20.00", "pass", 0, "Pass: all tolerances are met"),
        ("20.019", "in the guard band", 0, "neither conformity nor non-conformity is shown, in the guard band: D"),
        ("20.03", "fail", 6, "Fail: D is out of tolerance"),
    ],
)
def test_the_decision_stands_in_status_exit_code_and_page(
    parts: None, value: str, decision: str, code: int, words: str, metrocli: Metrocli
) -> None:
    ran = metrocli("report-uncertainty", f"{value}.yaml")
    assert ran.code == code and f"status: done, conformity: {decision}" in ran.out
    assert json.loads(metrocli("show", f"{value}.h5", "--json").out)["conformity"] == decision
    assert metrocli("report", f"{value}.h5", "--out", "page.html").code == 0
    assert words in Path("page.html").read_text()


def test_a_failing_part_can_be_exported_and_used(parts: None, metrocli: Metrocli) -> None:
    assert metrocli("report-uncertainty", "20.03.yaml").code == 6
    assert metrocli("export", "20.03.h5", "--to", "csv", "--out", "csv").code == 0
    Path("half.yaml").write_text(USER)
    assert metrocli("report-uncertainty", "half.yaml").code == 0


def test_a_job_may_only_report_it(parts: None, metrocli: Metrocli) -> None:
    ran = metrocli("report-uncertainty", "20.03.yaml", "--set", "conformity=report")
    assert ran.code == 0 and "conformity: fail" in ran.out


def test_a_project_with_a_failing_part_is_not_green(parts: None, metrocli: Metrocli) -> None:
    Path("metrocli.yaml").write_text("project: parts\njobs: [20.00.yaml, 20.019.yaml, 20.03.yaml]\n")
    ran = metrocli("run", ".")
    assert ran.code == 6 and "fail: out of tolerance" in ran.out and "1 out of tolerance" in ran.err
    assert metrocli("run", ".").code == 6
    assert metrocli("report", ".", "--out", "index.html").code == 0
    page = Path("index.html").read_text()
    assert "2 of 3 results are not shown to be in tolerance" in page and "up to date, fail" in page
    assert metrocli("gather", ".", "--out", "all.csv").code == 0
    table = Path("all.csv").read_text()
    assert all(word in table for word in ("conformity", "pass", "in the guard band", "fail", "D.U_mm"))


def test_check_judges_what_run_would_do(parts: None, metrocli: Metrocli) -> None:
    """A doubtful result that `run` replaces is not a fault; one that stays is."""
    first = JOB.replace("VALUE", "20.03").replace("tolerance: {D: [19.98 mm, 20.02 mm]}", 'require: {D: "< 20.02 mm"}')
    Path("20.03.yaml").write_text(first)
    Path("half.yaml").write_text(USER)
    Path("metrocli.yaml").write_text("project: parts\njobs: [20.03.yaml, half.yaml]\n")
    assert metrocli("run", ".").code == 6
    assert metrocli("check", ".").code == 3
    Path("20.03.yaml").write_text(first.replace("value: 20.03 mm", "value: 20.01 mm"))
    assert metrocli("check", ".").code == 0
    assert metrocli("run", ".").code == 0
