"""Forms of one cause, by time and by temperature: each has a status, a detectable size and a row of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.hidden import lengths
from metrocli.cli.diagnosis_report.candidates import candidate_lines
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.diagnosis.status import NOTHING, candidates


def steady(rate: float = 0.0) -> AdjustedJob:
    """Lengths in a room whose temperature swings by a few millikelvin, and whose air drifts with the time."""
    m = lengths.measurement(np.random.default_rng(47), 40)
    still = replace(m, temp=20 + 0.003 * np.sin(m.t / 97))
    return replace(still, length=still.length + rate * (m.t - m.t.min()) * m.distance).adjusted()


def of_air(job: AdjustedJob) -> dict[str, dict[str, object]]:
    rows = candidates(job, what_can_be_seen(job))
    return {str(one["by"]): one for one in rows if one["name"] == "refraction-drift"}


def test_each_form_has_its_own_status() -> None:
    job = steady()
    found = of_air(job)
    assert {by: one["status"] for by, one in found.items()} == {"t": "excluded", "T": "cannot-see"}
    assert found["t"]["above"]["unit"] != found["T"]["above"]["unit"]  # type: ignore[index]
    lines = [
        line for line in candidate_lines(job, what_can_be_seen(job), NOTHING) if line.startswith("refraction-drift")
    ]
    told = {tuple(line.split()[1:4]) for line in lines}
    assert told == {("by", "time", "excluded"), ("by", "temperature", "cannot-see")}


def test_forms_of_one_cause_are_no_pair_of_names() -> None:
    names = [(pair.one, pair.other) for pair in what_can_be_seen(steady()).pairs]
    assert names and not [pair for pair in names if all(name.startswith("refraction-drift") for name in pair)]


def test_a_form_that_does_not_explain_the_readings_is_not_named() -> None:
    diagnosis = diagnose(steady(2e-9))
    assert [one.effect.alternative.effect.by for one in diagnosis.findings] == ["t"]
    rows = candidates(diagnosis.job, diagnosis.design, diagnosis.conclusions)
    found = {one["by"]: one["status"] for one in rows if one["name"] == "refraction-drift"}
    assert found == {"t": "named", "T": "cannot-see"}
