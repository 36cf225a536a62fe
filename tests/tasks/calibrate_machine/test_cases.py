"""Measurements that another program simulated: tables within their uncertainty, the error of tools predicted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import SHARED

from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.described import machine_of

CASES = SHARED / "cases" / "calibrate-machine"
absent = pytest.mark.skipif(not CASES.exists(), reason="../shared/cases is not there")


def clean() -> list[Path]:
    """Cases with nothing in them that the model does not have."""
    if not CASES.exists():
        return []
    return [case for case in sorted(CASES.iterdir()) if not json.loads((case / "truth.json").read_text())["effects"]]


@pytest.mark.alike
@absent
@pytest.mark.parametrize("case", clean(), ids=lambda case: case.name)
def test_tables_are_true_within_their_uncertainty(case: Path) -> None:
    job, truth = load(case / "job.yaml"), json.loads((case / "truth.json").read_text())
    settings = job.settings.__class__(**{**job.settings.__dict__, "outliers": "remove"})
    result = calibrate_machine.run(calibrate_machine.TASK.job(settings, **read_inputs(job)))
    noise = truth["noise_ratio"]
    scores = []
    for name, table in truth["tables"].items():
        found = result.tables[f"tables/{name}"]
        assert found.numbers("position").tolist() == table["position"]
        std, off = found.numbers("std") * noise, found.numbers("value") - table["value"]
        scores.append(off[std > 1e-15] / std[std > 1e-15])
    scores.append(np.array([(e.value - truth["squareness"][e.name]) / (e.std * noise) for e in result.estimates]))
    z = np.concatenate(scores)
    assert np.abs(z).max() < 4.5
    assert (np.abs(z) < 1.96).mean() > 0.9
    assert result.statistics["sigma0"] == pytest.approx(noise, rel=0.1)
    assert set(result.tables["rejected"].texts("point")) == {outlier["point"] for outlier in truth["outliers"]}


@absent
@pytest.mark.parametrize("case", clean(), ids=lambda case: case.name)
def test_reference_points_are_predicted(case: Path) -> None:
    """Points that were not measured; where the whole is shifted and turned does not count."""
    from metrocli.tasks.calibrate_machine.methods.standstill import standstill
    from metrocli.tasks.calibrate_machine.solve import solve
    from metrocli.tasks.calibrate_machine.tables import tables_of
    from metrocli.tasks.calibrate_machine.volume import predict

    job, truth = load(case / "job.yaml"), json.loads((case / "truth.json").read_text())
    solved = solve(standstill(job.settings, **read_inputs(job)), True)
    tables = tables_of(machine_of(job.settings), solved.solution)
    reference = truth["reference"]
    position, error = np.array(reference["commanded"]).T, np.array(reference["error_mm"]).T
    names = list(job.settings.tools)
    tool = np.array([names.index(name) for name in reference["tool"]])
    scores = []
    for which in range(len(names)):
        at = position[:, tool == which]
        found, _ = predict(tables.machine, tables.blocks, (tables.unknowns, tables.raw), at, which)
        scores.append((found.error - error[:, tool == which]) / (found.std * truth["noise_ratio"]))
    z = np.concatenate([part.ravel() for part in scores])
    assert np.sqrt((z**2).mean()) < 1.5
    assert (np.abs(z) < 1.96).mean() > 0.85


def test_a_wave_shorter_than_the_pieces_of_a_path_is_not_called_excluded() -> None:
    from simulated import machine as sim

    from metrocli.diagnosis.diagnose import diagnose
    from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise

    rng = np.random.default_rng(81)
    machine = sim.random_machine(rng)
    flight = sim.flight(machine, sim.walls(rng, 31), rng, spacing=3.0)
    settings = sim.settings("on-the-fly", noise=MachineNoise(beam=1e-3, lateral=5e-3))
    adjusted = calibrate_machine.diagnosed(calibrate_machine.TASK.job(settings, path=flight.path, track=flight.track))
    found = diagnose(adjusted).design
    assert "screw-pitch-error" not in {one.alternative.effect.name for one in found.candidates}
    assert "backlash" in {one.alternative.effect.name for one in found.candidates}
    reasons = {one.effect.name: one.reason for one in found.not_tested}
    assert "longer than a pitch" in reasons["screw-pitch-error"]
