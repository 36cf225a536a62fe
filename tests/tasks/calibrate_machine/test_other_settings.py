"""A wrong chain or tool vector, which a repeatability that follows the residuals hides, is told and refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import machine as sim
from simulated import machine_lengths as lengths

from metrocli.adjust.dense_jacobian import least_square, unit_noise
from metrocli.diagnosis.other_settings import with_other_setting
from metrocli.formats import csv, hdf5
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.warnings import cures
from metrocli.tasks.shared.statistics import REMOVE

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: calibrate-machine
method: lengths
machine:
  chain: wXbYZt
  axes: {x: {range: [0 mm, 600 mm], knots: 5}, y: {range: [-260 mm, 260 mm], knots: 5}, z: {range: [-500 mm, 0 mm], knots: 5}}
  tools: {T1: [0 mm, 0 mm, 120 mm], T2: [110 mm, 20 mm, 150 mm], T3: [-30 mm, 100 mm, 210 mm]}
inputs: {lengths: lengths.csv}
noise: {constant: 0.3 um, proportional: 0.1 um/m, repeatability: estimated}
output: result.h5
"""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """Lengths to three tools of a machine that returns to 1 um, drawn by plain formulas."""
    rng = np.random.default_rng(133)
    table = lengths.measured(sim.random_machine(rng), rng, 150, sim.THREE, repeatability=1e-3)
    csv.write(tmp_path / "lengths.csv", replace(table, file=""))
    (tmp_path / "job.yaml").write_text(JOB)
    return tmp_path / "job.yaml"


def doubts(job: Path) -> str:
    return " ".join(hdf5.read(job.parent / "result.h5")[1].doubts)


def test_right_settings_are_not_doubted(job: Path, metrocli: Metrocli) -> None:
    assert metrocli("calibrate-machine", job).code == 0
    assert not doubts(job)


WRONG = {
    "machine.chain=wYbXZt": "the order of the axes is wXbYZt",
    "machine.tools.T2=[110 mm, 20 mm, 150.03 mm]": "the readings see other tool vectors than those listed",
}


@pytest.mark.alike
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_setting_makes_the_result_doubtful(wrong: str, job: Path, metrocli: Metrocli) -> None:
    """Chi-square is as expected in all of these: the repeatability is larger instead."""
    ran = metrocli("calibrate-machine", job, "--set", wrong)
    assert ran.code == 6, (ran.out, ran.err)
    assert WRONG[wrong] in doubts(job)
    assert hdf5.read(job.parent / "result.h5")[0].statistics["sigma0"] == pytest.approx(1, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG)
def test_diagnose_calls_a_wrong_setting_a_mistake(wrong: str, job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("diagnose", job, "--set", wrong, "--json")
    found = json.loads(ran.out)
    assert found["verdict"] == "mistaken", found["verdict"]
    assert WRONG[wrong] in json.dumps(found["mistake"])
    assert not found["effects"], "what is left is noise once the setting is right"


@pytest.mark.slow
def test_a_tool_with_the_wrong_sign_is_refused(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-machine", job, "--set", "machine.tools.T2=[-110 mm, 20 mm, 150 mm]")
    assert ran.code == 3, (ran.out, ran.err)
    assert "x of T2 has the wrong sign" in ran.err


@pytest.mark.slow
def test_a_model_that_does_not_fit_is_not_called_undetermined(job: Path, metrocli: Metrocli) -> None:
    """A repeatability as large as the residuals leaves nothing determined; the cause is what the message states."""
    ran = metrocli("calibrate-machine", job, "--set", "machine.tools.T2=[110 mm, 20 mm, 152 mm]")
    assert ran.code == 3, (ran.out, ran.err)
    assert "the model does not fit the lengths" in ran.err
    assert "cannot determine" not in ran.err
    assert "other tool vectors than those listed" in ran.err


def test_an_estimated_noise_does_not_hide_the_chain() -> None:
    rng = np.random.default_rng(134)
    table = sim.points(sim.random_machine(rng), rng, 200, sim.THREE)
    settings = sim.settings(tools=sim.THREE)
    settings = replace(settings, noise=replace(settings.noise, model="estimated"))

    def found(settings: Settings) -> str:
        job = calibrate_machine.TASK.job(settings, points=table)
        told = with_other_setting(calibrate_machine.diagnosed(job), partial(calibrate_machine.TASK.others, job))
        return str(told.mistakes[0]) if told else ""

    assert not found(settings)
    other = replace(settings, machine=replace(settings.machine, chain="wZbXYt"))
    assert found(other) == "machine.chain: the order of the axes is wXbYZt"


@pytest.mark.parametrize("chain", ["wXbYZt", "wZbYXt"])
def test_no_adjustment_is_below_the_least_sum_of_squares(chain: str) -> None:
    """Whatever the weights: those of an estimated repeatability are other ones in each adjustment."""
    rng = np.random.default_rng(55)
    table = lengths.measured(sim.random_machine(rng), rng, 70, sim.THREE, repeatability=1e-3)
    settings = lengths.settings(tools=sim.THREE)
    noise = replace(settings.noise, repeatability="estimated")
    machine = replace(settings.machine, chain=chain)
    job = calibrate_machine.TASK.job(replace(settings, noise=noise, machine=machine), lengths=table)
    start, solved = calibrate_machine.begun(job), calibrate_machine.diagnosed(job).model
    least = least_square(unit_noise(start.readings[0]), start.blocks)
    found = float((solved.readings[0].residuals(solved.blocks) ** 2).sum())
    assert 0.7 * found < least < 1.005 * found


def test_a_job_is_advised_nothing_that_it_has(job: Path) -> None:
    settings = content(load(job)).settings
    assert REMOVE in cures(settings) and REMOVE not in cures(replace(settings, outliers="remove"))


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1 / 25.4, "inches")])
def test_the_positions_of_one_station_in_another_unit_are_named(
    factor: float, unit: str, job: Path, metrocli: Metrocli
) -> None:
    """The lengths of the station were refused as those of another set-up."""
    path, text = job.parent / "lengths.csv", []
    for line in path.read_text().splitlines():
        cells = line.split(",")
        if "S2" in cells:
            at = [text[0].split(",").index(f"{axis}_mm") for axis in "xyz"]
            cells = [str(float(cell) * factor) if i in at else cell for i, cell in enumerate(cells)]
        text.append(",".join(cells))
    path.write_text("\n".join(text) + "\n")
    ran = metrocli("calibrate-machine", job)
    assert ran.code == 3 and f"x_mm, y_mm and z_mm of station S2 are in {unit}: with this corrected" in ran.err, ran.err


@pytest.mark.parametrize("effect", ["load-sag:pair=xz,c=2e-6 1/mm", "tracker-transit-tilt:angle=0.5 mrad"])
def test_an_effect_that_explains_as_much_is_no_wrong_setting(effect: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """It was "mistaken": another order of the axes, or other tools, which the readings fitted half as badly."""
    metrocli("init", tmp_path / "p", "--sample", "machine-methods")
    job = tmp_path / "p" / "jobs" / "standstill.yaml"
    metrocli("simulate", job, "--out", tmp_path / "new", "--effect", effect)
    (tmp_path / "new" / "points.csv").replace(tmp_path / "p" / "data" / "points.csv")
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert [(one["name"], found["mistake"]) for one in found["effects"]] == [(effect.partition(":")[0], None)]
    metrocli("calibrate-machine", job)
    assert "with this corrected" not in " ".join(hdf5.read(job.parents[1] / "results" / "standstill.h5")[1].doubts)


@pytest.mark.parametrize("column", ["z_mm", "mx_mm"])
def test_one_axis_in_inches_is_named(column: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """All axes alone were tried: one had "the shape of another path"."""
    metrocli("init", tmp_path / "p", "--sample", "machine-methods")
    job, points = tmp_path / "p" / "jobs" / "standstill.yaml", tmp_path / "p" / "data" / "points.csv"
    head, *rows = points.read_text().splitlines()
    at = head.split(",").index(column)
    cells = [row.split(",") for row in rows]
    changed = [[*row[:at], f"{float(row[at]) / 25.4:.9f}", *row[at + 1 :]] for row in cells]
    points.write_text("\n".join([head, *map(",".join, changed)]) + "\n")
    found = json.loads(metrocli("diagnose", job, "--json").out)["mistake"]
    assert (found["what"], found["alternatives"]) == (f"{column} is in inches", [])
