"""`noise: {model: structured}`: intervals contain the truth where readings taken together share errors.

The measurements are simulated by plain formulas (tests/simulated), with a smooth process beside the white noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from simulated import grid, launch, lengths, machine_lengths
from simulated import machine as machines

from benchmarks import shared_errors
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.findings import RemainingStructure
from metrocli.errors import UndeterminedError
from metrocli.formats import csv
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import load
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise
from metrocli.tasks.locate_launch_unit import task as locate_launch_unit
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.selfcal_grid import task as selfcal_grid

Metrocli = Callable[..., Any]


@pytest.mark.parametrize(
    ("kind", "runs", "white"),
    [
        pytest.param("multilaterate", 16, 88, marks=pytest.mark.slow),
        pytest.param("locate-launch-unit", 40, 88, marks=pytest.mark.slow),
        ("calibrate-machine", 3, 92),
    ],
)
def test_intervals_contain_the_truth_where_those_for_white_noise_do_not(kind: str, runs: int, white: float) -> None:
    found = shared_errors.coverage(kind, 1.0, runs)
    shares, growth = found.shares, found.growth
    assert 91 <= shares["structured"][0] <= 99.5
    assert shares["estimated"][0] < white
    assert growth > 1.2


@pytest.mark.slow
def test_each_parameter_is_covered_where_poses_of_great_weight_have_great_errors() -> None:
    """A receiver that stands elsewhere moves x and y of the unit, mostly by poses nearly above it, and gamma little."""
    found = shared_errors.coverage("locate-launch-unit", 1.0, 100, 5).found
    assert (np.mean([one.inside for one, _ in found], axis=0) >= 0.88).all()


def test_errors_of_successive_balls_count_in_the_machine_errors() -> None:
    true = grid.grid(3, "12345", seed=2)
    read = true.read(np.random.default_rng(4))
    found = {}
    for model in ("estimated", "structured"):
        job = selfcal_grid.TASK.job(true.settings(noise=model, leave_one_out="no"), read)
        found[model] = selfcal_grid.run(job)
    white, result = (found[model].tables["machine_error"] for model in ("estimated", "structured"))
    std, less = (each.stacked(["s_ex", "s_ey", "s_ez"]) for each in (result, white))
    assert (result.stacked(["ex", "ey", "ez"]) == white.stacked(["ex", "ey", "ez"])).all()
    assert (std >= less * (1 - 1e-6)).all()
    stated = found["structured"].statistics
    assert (stated["clusters"], stated["noise_model"]) == (30, "cluster-robust over blocks of successive balls")
    assert stated["inflation"] == pytest.approx(float(np.sqrt(np.mean((std / less) ** 2))), rel=1e-6)
    assert len({one["dof"] for one in found["structured"].details.values()}) == 1


def network(model: str, points: int = 30, declared: float = 1.0) -> Result:
    net = lengths.network(points, 5, seed=8)
    settings = lengths.settings()
    size = replace(
        lengths.NOISE, constant=declared * lengths.NOISE.constant, proportional=declared * lengths.NOISE.proportional
    )
    settings = replace(settings, noise=replace(size, model=model))
    return multilaterate.run(multilaterate.TASK.job(settings, net.lengths(), net.point_table(), net.tracer_table()))


def test_lengths_of_one_stop_are_in_one_block_whatever_their_order_in_the_file() -> None:
    rng = np.random.default_rng(482)
    noise = MachineNoise(constant=0.3e-3, repeatability=2e-3, model="structured")
    machine = machines.random_machine(rng, knots=(3, 3, 3))
    read = machine_lengths.measured(machine, rng, 50, machines.THREE, noise=noise, repeatability=2e-3, together=True)
    settings = machine_lengths.settings(machines.THREE, (3, 3, 3), noise)

    def found(rows: Table) -> Result:
        return calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=rows))

    by_station, mixed = found(read), found(read.selected(rng.permutation(len(read))))
    np.testing.assert_allclose(mixed.covariance, by_station.covariance, rtol=1e-5)


def test_the_factor_of_the_declared_parts_is_found() -> None:
    """Noise declared a fourth as large gives the result of the true noise, times its sigma0."""
    declared, quarter = network("declared"), network("estimated", declared=0.25)
    sigma0 = declared.statistics["sigma0"]
    assert isinstance(sigma0, float)
    assert quarter.statistics["noise_factor"] == pytest.approx(4 * sigma0, rel=1e-3)
    assert quarter.statistics["noise_estimated"] and "p_value" not in quarter.statistics
    for one, other in zip(declared.estimates, quarter.estimates, strict=True):
        assert (one.name, one.value) == (other.name, pytest.approx(other.value, abs=1e-3 * one.std))
        assert other.std == pytest.approx(sigma0 * one.std, rel=1e-3)
    spread, scaled = (each.tables["points"].numbers("sx") for each in (declared, quarter))
    assert scaled == pytest.approx(sigma0 * spread, rel=1e-3)


def test_the_result_states_the_model() -> None:
    white, found = network("estimated"), network("structured")
    assert found.statistics["noise_model"] == "cluster-robust over blocks of successive points"
    assert found.statistics["clusters"] == 6
    variances = [np.array([one.std**2 for one in each.estimates]) for each in (found, white)]
    assert found.statistics["inflation"] == pytest.approx(np.sqrt(np.mean(variances[0] / variances[1])), rel=1e-6)
    assert (variances[0] >= variances[1] * (1 - 1e-9)).all()
    dof = {one["dof"] for one in found.details.values()}
    assert len(dof) == 1 and 3 < dof.pop() < white.statistics["dof"]
    assert any("cluster-robust over 6 blocks of successive points" in line for line in found.notes)
    residuals = [each.tables["residuals"] for each in (found, white)]
    for column in ("redundancy", "normalised", "detectable", "moves_point"):
        assert residuals[0].numbers(column) == pytest.approx(residuals[1].numbers(column), rel=1e-6)


def test_too_few_clusters_are_refused() -> None:
    with pytest.raises(UndeterminedError, match="4 blocks of successive points are too few"):
        network("structured", points=9)
    read = launch.anywhere(4, 1).noisy(np.random.default_rng(1))
    settings = launch.settings(noise=replace(launch.NOISE, model="structured"))
    with pytest.raises(UndeterminedError, match="4 poses are too few"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings, read.table()))


JOB = """metrocli: 1
job: locate-launch-unit
inputs: {poses: poses.csv}
noise: {encoder: 5 arcsec, model: estimated}
output: r.h5
"""


@pytest.fixture
def poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A job of eight poses; its folder is the working folder."""
    monkeypatch.chdir(tmp_path)
    read = launch.anywhere(8, 1).noisy(np.random.default_rng(1)).table()
    units = dict.fromkeys("xyz", "mm") | dict.fromkeys(("spindle", "phi1", "phi2", "phi3", "phi4"), "rad")
    csv.write(Path("poses.csv"), replace(read, units=units))
    Path("job.yaml").write_text(JOB)
    return Path("job.yaml")


def test_a_method_without_residuals_cannot_estimate(poses: Path, metrocli: Metrocli) -> None:
    poses.write_text(JOB + "method: lines\n")
    ran = metrocli("locate-launch-unit", poses)
    assert ran.code == 3 and "only `method: adjustment`" in ran.err and "job.yaml:4" in ran.err


def test_the_extended_job_has_the_model_beside_the_declared_parts(poses: Path, metrocli: Metrocli) -> None:
    job = load(poses)
    found = carry_out(job)
    assert (found.job.declared, found.job.noise_model, found.job.sharing) == ("5 arcsec", "estimated", 8)
    left = replace(found, left=RemainingStructure(1e-9, ("t_s",)))
    written = write_extended(job, left)
    assert written is not None and written.law is None
    extended = written.path
    assert "those of the extended job, with `model: structured`, include it" in of_diagnosis(left, written)
    assert "those of the extended job" not in of_diagnosis(left, None), "none was written"
    assert "noise:\n  encoder: 5 arcsec\n  model: structured\n" in extended.read_text()
    assert metrocli("locate-launch-unit", extended).code == 0
    with h5py.File("r.extended.h5") as result:
        assert result["statistics"].attrs["clusters"] == 8
        assert result["statistics"].attrs["inflation"] >= 1 - 1e-9
    assert write_extended(load(extended), replace(left, job=replace(left.job, noise_model="structured"))) is None
