"""Measurements with a hidden effect that were simulated elsewhere (skipped where they are absent)."""

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

CASES = SHARED / "cases"
KINDS = ("multilaterate", "locate-launch-unit", "align-part", "calibrate-camera")
MISSED = "align-part/034"
"""Three of its 16 coordinates are wrong: nine degrees of freedom do not tell them from an effect"""
LEFT_OUT = {f"calibrate-camera/{number:03d}" for number in (1, 2, 4, 6, 7, 9, 10, 11, 14, 15)}
"""Calibrations with a board take 4 s each: outliers, two names, a bent board, an outside effect and two effects stand for
them"""
SEEN_ONCE = {"locate-launch-unit/013": "a bad pose that only its distance sees is told as a wrong distance"}
FOLDERS = [folder for kind in KINDS for folder in sorted((CASES / kind).glob("*")) if (folder / "truth.json").is_file()]
FOLDERS = [folder for folder in FOLDERS if f"{folder.parent.name}/{folder.name}" not in LEFT_OUT]
pytestmark = pytest.mark.skipif(not FOLDERS, reason=f"no cases at {CASES}")


def right(diagnosis: Diagnosis, truth: dict[str, Any]) -> bool:
    """Whether the verdict is what the truth asks for."""
    told = {_spot(finding.effect.alternative) for finding in diagnosis.findings}
    sets = told | {_spot(rival.alternative) for finding in diagnosis.findings for rival in finding.effect.rivals}
    planted = [effect for effect in truth["effects"] if effect.get("identifiable", True)]
    if not planted:
        return diagnosis.verdict == "clean"
    for effect in planted:
        if effect["name"].startswith("_"):
            if diagnosis.verdict != "unexplained":
                return False
            continue
        also = [effect, *effect.get("alternatives", []), *effect.get("rivals", [])]
        accepted = {(one["name"], _place(one)) for one in also}
        if (effect["name"], _place(effect)) not in sets and not accepted & told:
            return False
    return len(diagnosis.findings) <= len(planted)


def _place(effect: dict[str, Any]) -> frozenset[tuple[str, str]]:
    """The place as the contract has it: launch unit and receiver cannot be told apart by a beam's offset."""
    where = {} if effect["name"] == "beam-offset" else effect.get("where", {})
    return frozenset(where.items())


def _spot(alternative: Alternative) -> tuple[str, frozenset[tuple[str, str]]]:
    """Cause and place; time or temperature is no place."""
    return alternative.effect.name, frozenset((key, name) for key, name in alternative.where.items() if key != "by")


def _marked(folder: Path) -> Any:
    name = f"{folder.parent.name}/{folder.name}"
    missed = pytest.mark.xfail(name == MISSED, reason="too few readings for three wrong ones", strict=True)
    return pytest.param(folder, marks=missed, id=name)


@pytest.mark.parametrize("folder", [_marked(folder) for folder in FOLDERS])
def test_the_verdict_is_right(folder: Path) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    diagnosis = diagnose(adjusted_job_of(load(folder / "job.yaml")))
    if (reason := SEEN_ONCE.get(f"{folder.parent.name}/{folder.name}")) and not diagnosis.findings:
        assert {outlier.keys["pose"] for outlier in diagnosis.outliers} == {truth["effects"][0]["where"]["pose"]}
        pytest.xfail(reason)
    assert right(diagnosis, truth), (diagnosis.verdict, [str(f.effect.alternative) for f in diagnosis.findings])
    if truth["kind"] == "multilaterate":
        wrong = {(one["point"], one["tracer"]) for one in truth["outliers"]}
        assert {(one.keys["point"], one.keys["tracer"]) for one in diagnosis.outliers} == wrong
    if truth["kind"] not in ("align-part", "calibrate-camera"):  # outliers among few are found in the campaign only
        assert diagnosis.noise.low * 0.97 <= truth["noise_ratio"] <= diagnosis.noise.high * 1.03
