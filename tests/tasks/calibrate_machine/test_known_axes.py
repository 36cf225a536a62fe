"""Rotary axes beside linear ones that an earlier calibration gives with their covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli.errors import InputError
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.project.runner import carry_out, simulate
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.tasks.calibrate_machine import task as calibrate_machine

FIVE = sim.KINDS["head-table"]
THREE = sim.Kind("bXYZ", {key: axis for key, axis in FIVE.axes.items() if key in "XYZ"}, {}, FIVE.tools, FIVE.balls)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, sim.Machine]:
    """A five-axis machine whose linear axes a tracker has measured, and whose rotary ones are probed."""
    rng, path = np.random.default_rng(31), tmp_path_factory.mktemp("known")
    machine = sim.drawn(FIVE, rng)
    tables = {name: table for name, table in machine.tables.items() if name[-1] in "XYZ"}
    square = {name: machine.places[name] for name in ("A0Z", "B0Z", "C0Y")}
    three = sim.Machine(THREE, {key: machine.knots[key] for key in "XYZ"}, tables, square)
    (path / "linear").mkdir()
    first = sim.tracked(path / "linear", three, rng, 250, (1e-3, 1e-3, 3e-6))
    carry_out(load(first))
    job = sim.probed(path, machine, rng, 120, 0.5e-3)
    job.write_text(job.read_text().replace("balls: balls.csv", "balls: balls.csv, machine: linear/result.h5"))
    return job, machine


def result(job: Path) -> Result:
    file = load(job)
    return calibrate_machine.run(calibrate_machine.TASK.job(file.settings, effects=file.effects, **read_inputs(file)))


def changed(job: Path, old: str, new: str, name: str) -> Path:
    assert old in job.read_text()
    path = job.with_name(name)
    path.write_text(job.read_text().replace(old, new))
    return path


@pytest.mark.slow
def test_the_uncertainty_of_the_linear_axes_is_in_that_of_the_rotary_ones(folder: tuple[Path, sim.Machine]) -> None:
    job, machine = folder
    found = result(job)
    status = dict(zip(found.tables["errors"].texts("error"), found.tables["errors"].texts("status"), strict=True))
    assert {status[name] for name in machine.tables if name[-1] in "XYZ"} == {"given"}
    assert status["EXC"] == status["EX0C"] == "determined"
    tables = [(found.tables[f"tables/{name}"], machine.tables[name]) for name in machine.tables if name[-1] in "BC"]
    off = [(one.numbers("value") - true, one.numbers("std")) for one, true in tables]
    off += [(np.array([e.value - machine.places[e.name]]), np.array([e.std])) for e in found.estimates if e.std > 0]
    z = np.concatenate([(d / s)[s > 1e-9] for d, s in off])
    assert 0.8 < float(np.sqrt((z**2).mean())) < 1.2
    assert 0.8 < float(found.statistics["sigma0"]) < 1.2  # type: ignore[arg-type]


def test_other_knots_are_refused_with_those_to_write(folder: tuple[Path, sim.Machine]) -> None:
    job, _ = folder
    other = changed(job, "range: [-700 mm, 700 mm], knots: 4", "range: [-700 mm, 700 mm], knots: 2", "knots.yaml")
    with pytest.raises(InputError, match=r"the result has 4 knots of X from -700 to 700 mm, the job 2") as caught:
        result(other)
    assert "write `x: {range: [-700 mm, 700 mm], knots: 4}`" in str(caught.value)


def test_a_result_of_which_nothing_is_taken_is_refused(folder: tuple[Path, sim.Machine]) -> None:
    job, _ = folder
    with pytest.raises(InputError, match="the job estimates all errors of the linear axes that the result has"):
        result(changed(job, "estimate: rotary", "estimate: all", "all.yaml"))


def test_a_simulated_machine_has_linear_axes_within_what_is_known_of_them(folder: tuple[Path, sim.Machine]) -> None:
    job, machine = folder
    text = "simulation: {points: 60, error: 5 um}\n"
    made = simulate(load(changed(job, "output:", f"{text}output:", "simulated.yaml")), SimulationOptions(seed=4))
    true = made.files["true_errors.csv"]
    known = np.array([name[-1] in "XYZ" and name[1] in "XYZ" for name in true.texts("error")])
    drawn = true.numbers("value")[known]
    own = np.concatenate([machine.tables[n] for n in dict.fromkeys(np.array(true.texts("error"))[known].tolist())])
    assert 1e-5 < np.abs(drawn - own).max() < 8e-3
    assert np.corrcoef(drawn, own)[0, 1] > 0.9
