"""Usual sizes stand in the unit of the size that is compared with them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import lengths
from metrocli.cli.diagnosis_report.candidates import candidate_lines
from metrocli.cli.diagnosis_report.findings import _parameter
from metrocli.diagnosis.diagnose import what_can_be_seen
from metrocli.diagnosis.extended_fit import EffectSize
from metrocli.diagnosis.status import NOTHING, Status, reason, status, usual_beside
from metrocli.tasks.calibrate_camera.effects import EFFECTS as OF_CAMERAS
from metrocli.tasks.locate_launch_unit.effects import EFFECTS as OF_LAUNCH_UNITS

EFFECTS = {one.name: one for one in (*OF_CAMERAS, *OF_LAUNCH_UNITS)}


@pytest.mark.parametrize(
    ("name", "size", "said"),
    [
        ("aspect-ratio", 19e-6, "10 to 10000 um/m"),
        ("target-plane-bend", 4.1e-7, "0.0001 to 0.01 1/m"),
        ("machine-squareness", 5.8e-5, "1 to 210 arcsec"),
        ("machine-scale", 35e-6, "1 to 1000 um/m"),
        ("target-eccentricity", 4.4, "0.5 to 1"),
        ("encoder-offset", 5.8e-5, "5 to 3600 arcsec"),
        # no one unit suits both ends
        ("distance-offset", 1.0, "1 um to 10 mm"),
    ],
)
def test_usual_sizes_are_in_the_unit_of_the_size(name: str, size: float, said: str) -> None:
    assert usual_beside(EFFECTS[name], size) == said


def test_the_table_compares_in_one_unit() -> None:
    job = lengths.measurement(np.random.default_rng(24), 16).adjusted()
    lines = candidate_lines(job, what_can_be_seen(job), NOTHING)
    rows = [line for line in lines if line.startswith(("tracer-scale", "length-scale", "air-gradient"))]
    assert rows
    assert not [line for line in rows if "ppm" in line or "1/mm" in line]


def test_beside_what_cannot_be_seen_stands_the_size_for_which_it_falsifies_the_result() -> None:
    job = lengths.measurement(np.random.default_rng(24), 16).adjusted()
    design = what_can_be_seen(job)
    unseen = [one for one in design.candidates if status(one) == Status.CANNOT_SEE]
    assert unseen and all(one.assumed >= one.plausible for one in unseen)
    lines = [line for line in candidate_lines(job, design, NOTHING) if "cannot-see" in line]
    assert lines and all("off by this if its size is" in line for line in lines)
    assert all("what it hides is for" in reason(one, Status.CANNOT_SEE) for one in unseen)


def test_a_size_of_nearly_nothing_has_the_unit_of_its_uncertainty() -> None:
    moved = EFFECTS["moved-target"].parameters[0]
    assert _parameter(EffectSize(moved, 0.4, 27.0)) == "dx = 0 ± 27 mm"
    assert _parameter(EffectSize(moved, 0.4, 0.03)) == "dx = 0.400 ± 0.030 mm"
