"""What an extended job is without: effects that held-out readings speak against, and what it cannot be adjusted with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from metrocli.cli.commands import run
from metrocli.cli.diagnosis_report.headline import summary
from metrocli.diagnosis.findings import Verdict
from metrocli.effects.extension import with_effect
from metrocli.errors import UndeterminedError
from metrocli.project import diagnosed
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import load
from metrocli.project.until_clean import End, until_clean


def test_what_predicts_held_out_readings_worse_is_not_written(tmp_path: Path) -> None:
    folder = tmp_path / "gear"
    assert run(["init", str(folder), "--sample", "gear-m3d3"]) == 0
    job = load(folder / "jobs" / "tip4.yaml")
    diagnosis = carry_out(job)
    (finding,) = diagnosis.findings
    assert diagnosis.verdict is Verdict.EXPLAINED
    worse = replace(diagnosis, findings=(replace(finding, gain=replace(finding.gain, log_score=-0.1)),))
    assert worse.verdict is Verdict.INDISTINCT
    # the density of held-out readings gains, but their errors grow by 7 %
    larger = replace(diagnosis, findings=(replace(finding, gain=replace(finding.gain, ratio=1.07)),))
    assert larger.verdict is Verdict.INDISTINCT and "explain" not in "".join(summary(larger))
    # two of which none explains anything alone, as of a noise that hardly stays
    both = replace(larger, findings=2 * larger.findings, together=finding.gain)
    assert "  dead-path-jump LT2, dead-path-jump LT2 explain " in "".join(summary(both))
    # beside the effects of an extended job, what explains less than 5 % of its misfit is a rest, whatever its cause
    scale = next(effect for effect in larger.job.effects if effect.name == "tracer-scale")
    model = with_effect(larger.job.model, scale, [("LT1",)], {})
    beside = replace(larger, job=replace(larger.job, model=model))
    assert beside.verdict is Verdict.EXPLAINED and "jump LT2 explains little of the misfit" in "".join(summary(beside))
    assert write_extended(job, worse) is None
    written = write_extended(job, diagnosis)
    assert written is not None and "dead-path-jump" in written.path.read_text(encoding="utf-8")
    # without a solution with the named effect, what has it would fail
    assert write_extended(job, replace(diagnosis, adjusts=False)) is None
    assert until_clean(job, lambda _: replace(diagnosis, adjusts=False)).end is End.NOTHING_GAINED


@pytest.mark.slow
def test_a_job_that_fails_is_not_proposed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lengths of two digits determine no point within the noise that they have."""
    folder = tmp_path / "hall"
    assert run(["init", str(folder), "--sample", "laboratory-effects"]) == 0
    first, *rows = (file := folder / "data" / "lengths.csv").read_text(encoding="utf-8").splitlines()
    at = first.split(",").index("length_mm")
    read = [row.split(",") for row in rows]
    coarse = [",".join([*row[:at], f"{float(row[at]):.1e}", *row[at + 1 :]]) for row in read]
    file.write_text("\n".join([first, *coarse, ""]), encoding="utf-8")
    job = folder / "jobs" / "hall.yaml"
    assert run(["diagnose", str(job)]) == 0
    shown = capsys.readouterr()
    assert "cannot be adjusted with what was found: the layout does not determine the points" in shown.err
    assert "next:" not in shown.out and not job.with_name("hall.extended.yaml").exists()


def test_the_loop_ends_with_a_job_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "gear"
    assert run(["init", str(folder), "--sample", "gear-m3d3"]) == 0
    job = load(folder / "jobs" / "tip4.yaml")
    monkeypatch.setattr(diagnosed, "_refusal", lambda path, law: UndeterminedError("nothing is determined"))
    loop = until_clean(job)
    assert loop.end is End.NOTHING_GAINED and not loop.extensions and loop.last.findings
    assert not job.file.with_name("tip4.step1.yaml").exists()
