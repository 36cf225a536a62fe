"""An effect with a negative held-out score is in no extended job, and no verdict says that it explains the readings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from metrocli.cli.commands import run
from metrocli.diagnosis.findings import Verdict
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import load


def test_what_predicts_held_out_readings_worse_is_not_written(tmp_path: Path) -> None:
    folder = tmp_path / "gear"
    assert run(["init", str(folder), "--sample", "gear-m3d3"]) == 0
    job = load(folder / "jobs" / "tip4.yaml")
    diagnosis = carry_out(job)
    (finding,) = diagnosis.findings
    assert diagnosis.verdict is Verdict.EXPLAINED
    worse = replace(diagnosis, findings=(replace(finding, gain=replace(finding.gain, log_score=-0.1)),))
    assert worse.verdict is Verdict.INDISTINCT
    assert write_extended(job, worse) is None
    written = write_extended(job, diagnosis)
    assert written is not None and "dead-path-jump" in written.path.read_text(encoding="utf-8")
