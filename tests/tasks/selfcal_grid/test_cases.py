"""Views of a ball grid with a hidden effect that were simulated elsewhere (skipped where they are absent).

A part of the cases, for the time they take; the others are named so that a run of all is one edit away.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from places import SHARED

from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

CASES = SHARED / "cases" / "selfcal-grid"
CHOSEN = ("001", "003", "006", "007", "008", "010", "013", "022")
FOLDERS = [CASES / name for name in CHOSEN if (CASES / name / "truth.json").is_file()]
pytestmark = pytest.mark.skipif(not FOLDERS, reason=f"no cases at {CASES}")


def place(where: dict[str, Any]) -> frozenset[tuple[str, str]]:
    """A place with a ball by its name."""
    named = {key: " ".join(map(str, value)) if isinstance(value, list) else str(value) for key, value in where.items()}
    return frozenset(named.items())


def spot(alternative: Alternative) -> tuple[str, frozenset[tuple[str, str]]]:
    """Cause and place, with the view from which a ball moved."""
    return alternative.effect.name, place(alternative.where | dict(alternative.named))


def right(diagnosis: Diagnosis, truth: dict[str, Any]) -> bool:
    """Whether the verdict is the expected one, and every planted effect stands in a set of names."""
    sets = {spot(finding.effect.alternative) for finding in diagnosis.findings}
    sets |= {spot(rival.alternative) for finding in diagnosis.findings for rival in finding.effect.rivals}
    known = [one for one in truth["effects"] if not one["name"].startswith("_")]
    named = all((one["name"], place(one["where"])) in sets for one in known)
    return diagnosis.verdict == truth["expected_verdict"] and named and len(diagnosis.findings) == len(known)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_verdict_is_right(folder: Path) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    diagnosis = diagnose(adjusted_job_of(load(folder / "job.yaml")))
    assert right(diagnosis, truth), (diagnosis.verdict, [str(f.effect.alternative) for f in diagnosis.findings])
    wrong = {(one["view"], *map(str, one["ball"]), one["axis"]) for one in truth["outliers"]}
    assert {tuple(one.keys[key] for key in ("view", "i", "j", "k", "component")) for one in diagnosis.outliers} == wrong
    assert diagnosis.noise.low * 0.97 <= truth["noise_ratio"] <= diagnosis.noise.high * 1.03
