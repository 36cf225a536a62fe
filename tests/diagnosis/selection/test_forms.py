"""Forms of one cause that the readings do not tell apart are all reported."""

from dataclasses import replace

import numpy as np

from benchmarks.hidden import lengths
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.verdict import as_data


def drifting(warming: float) -> lengths.Measurement:
    """Return lengths in air whose refraction drifts with its temperature; this rises evenly, but for a swing."""
    rng = np.random.default_rng(41)
    m = lengths.measurement(rng, 60)
    m = replace(m, temp=20 + m.t / 1600 + (1 - warming) * np.sin(m.t / 150))
    change = lengths.signature("refraction-drift", 0, {"rate": 1e-6, "by": 1.0})(m)
    return replace(m, length=m.length + change)


def test_time_and_temperature_that_run_alike_are_both_reported() -> None:
    found = diagnose(drifting(1.0).adjusted())
    (effect,) = as_data(found)["effects"]
    (form,) = effect["forms"]
    assert {effect["by"], form["by"]} == {"t", "T"}
    assert 0.9 < form["odds"] < 1.1
    told = f"its size is that of `by: {effect['by']}`; `by: {form['by']}` (odds {form['odds']:.2g}) fits as well"
    assert told in of_diagnosis(found, None)


def test_a_swing_of_the_temperature_tells_them_apart() -> None:
    (effect,) = as_data(diagnose(drifting(0.5).adjusted()))["effects"]
    assert effect["by"] == "T" and not effect["forms"]
