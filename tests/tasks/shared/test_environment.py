"""Lengths in air: corrected for its index, with an uncertainty that all share.

The indices are those that NIST publishes for checking programs (dry air, 633 nm), with nine decimals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import launch
from simulated import machine as machines
from simulated import machine_lengths as of_machine
from simulated.lengths import Network, network, places, settings, without_motion

from metrocli.formats import csv, hdf5
from metrocli.result import Estimate, Result
from metrocli.settings import KnownQuantity
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.locate_launch_unit import task as locate_launch_unit
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.tasks.multilaterate.settings import POINTS
from metrocli.tasks.shared.environment import Assumed, Environment

STANDARD, LOW, HIGH, COLD = 1.000271800, 1.000160924, 1.000321916, 1.000282756
"""Index at 20 degC and 1013.25, 600, 1200 hPa, and at 5 degC and 1000 hPa"""
PPM = 1e-6
ONE_PPM = 600 * PPM / (HIGH - LOW)
ONE_PPM_COLD = 1000 * PPM / (COLD - 1)
"""Uncertainty of the pressure [hPa] that makes lengths uncertain by 1 ppm, from the published values"""


def environment(temperature: float = 20.0, pressure: float = 1013.25, std: float = 0.0) -> Environment:
    """Dry air, read by instruments that assume dry air of 20 degC and 1013.25 hPa."""
    return Environment(
        KnownQuantity(temperature),
        KnownQuantity(pressure, std),
        KnownQuantity(0.0),
        KnownQuantity(633e-6),
        Assumed(20.0, 1013.25, 0.0),
    )


def run(net: Network, lengths: Table, air: Environment, **more: Table) -> Result:
    job = replace(settings(), environment=air)
    return multilaterate.run(multilaterate.TASK.job(job, lengths, net.point_table(), **more))


def in_air(net: Network, index: float) -> Table:
    """Lengths that instruments with the standard index display in air of another."""
    return replace(net, readings=net.readings * index / STANDARD).lengths()


def relative(result: Result) -> float:
    found = max((distance(result, "P0", f"P{i}") for i in range(1, 20)), key=lambda one: one.value)
    return found.std / found.value


def size(points: np.ndarray) -> float:
    return float(np.linalg.norm(points - points.mean(axis=0)))


def test_lengths_are_corrected_from_the_assumed_air_to_the_true_one() -> None:
    net = network(30, 5, noise=0.0)
    result = run(net, in_air(net, COLD), environment(5.0, 1000.0))
    found = places(result.tables["points"])
    # nine decimals of the published index are 1 nm of 1 m
    assert np.abs(without_motion(found, net.points) - net.points).max() < 3e-6
    assert result.tables["tracers"].numbers("dead_path") == pytest.approx(net.dead, abs=5e-6)
    assert any("corrected for the air" in note and "-11 um/m" in note for note in result.notes)
    as_assumed = run(net, in_air(net, COLD), environment())
    assert any("the air is the one that the lengths assume" in note for note in as_assumed.notes)
    uncorrected = places(as_assumed.tables["points"])
    assert size(uncorrected) / size(net.points) - 1 == pytest.approx(COLD / STANDARD - 1, rel=1e-3)


def test_each_reading_has_its_own_weather_also_in_the_dead_path() -> None:
    """The pressure falls from 1200 hPa to 600 hPa half way; what was counted at the start, l0, stays as it was."""
    net = network(30, 5, noise=0.0)
    change = np.where(np.arange(30) < 15, HIGH, LOW)[:, None]
    path = np.linalg.norm(net.points[:, None] - net.tracers, axis=2)
    read = replace(net, readings=(change * path - HIGH * net.dead) / STANDARD).lengths()
    point = np.array([int(name[1:]) for name in read.texts("point")])
    weather = {"pressure": np.where(point < 15, 1200.0, 600.0), "humidity": np.zeros(len(point))}
    table = replace(read, columns={**read.columns, **weather})
    # the columns come before the entries of the job
    result = run(net, table, environment(pressure=900.0))
    assert np.abs(without_motion(places(result.tables["points"]), net.points) - net.points).max() < 1e-5
    assert result.tables["tracers"].numbers("dead_path") == pytest.approx(net.dead, abs=1e-5)


@pytest.mark.parametrize("tracers", [4, 8])
def test_weather_of_1_ppm_gives_1_ppm_whatever_the_number_of_tracers(tracers: int) -> None:
    net = network(20, tracers, seed=tracers, noise=0.0)
    # what is stated: 1 ppm more than without, in quadrature
    result = run(net, net.lengths(), environment(std=ONE_PPM))
    without = relative(run(net, net.lengths(), environment()))
    assert np.sqrt(relative(result) ** 2 - without**2) == pytest.approx(PPM, rel=1e-3)
    # what the result is off by if the index is off by that: all of it, and it does not show
    index = 1 + PPM
    off = replace(net, scale=np.full(tracers, index)).read(np.random.default_rng(0), 0.0)
    wrong = run(net, off.lengths(), environment(std=ONE_PPM))
    assert size(places(wrong.tables["points"])) / size(net.points) - 1 == pytest.approx(PPM, rel=1e-3)
    assert wrong.statistics["sigma0"] == pytest.approx(0.0, abs=1e-6)
    scale = next(one for one in result.estimates if one.name == "air.scale")
    assert scale.std == pytest.approx(PPM, rel=1e-3)
    assert result.covariance.shape == (len(result.estimates),) * 2
    hidden = result.tables["not_controlled"]
    assert "common error of the refractive index" not in hidden.texts(next(iter(hidden)))


def test_the_air_that_instruments_assume_is_not_controlled() -> None:
    """It has no uncertainty: 1 K off moves the points as far as stated, and no residual shows it."""
    net = network(20, 5, noise=0.0)
    air = environment(std=ONE_PPM)
    right, wrong = (
        run(net, net.lengths(), replace(air, assumed=Assumed(20.0 + off, 1013.25, 0.0))) for off in (0.0, 1.0)
    )
    assert wrong.statistics["sigma0"] == pytest.approx(0.0, abs=1e-6)
    changed = abs(size(places(wrong.tables["points"])) / size(places(right.tables["points"])) - 1)
    hidden = right.tables["not_controlled"]
    assumed = [
        i for i, effect in enumerate(hidden.texts("effect")) if effect.startswith("air that the instrument assumes")
    ]
    extent = np.linalg.norm(np.ptp(net.nominal, axis=0))
    assert hidden.numbers("hides")[assumed] / extent == pytest.approx(
        [changed], rel=0.05
    )  # dry air; 0.96 um/m is moist


def test_parts_of_the_weather_and_the_wavelength_add_in_quadrature() -> None:
    net = network(20, 5)
    given = replace(environment(std=3 * ONE_PPM), wavelength=KnownQuantity(633e-6, 4 * PPM * 633e-6))
    assert relative(run(net, net.lengths(), given)) == pytest.approx(5 * PPM, rel=0.01)


def test_a_calibrated_distance_finds_the_error_of_the_air() -> None:
    net = network(20, 5, noise=0.0)
    off = replace(net, scale=np.full(5, 1 + 2 * PPM)).read(np.random.default_rng(1), 0.0)
    bar = np.linalg.norm(net.points[0] - net.points[1])
    columns = {"from": np.array(["P0"]), "to": np.array(["P1"]), "length": np.array([bar]), "sigma": np.array([1e-6])}
    bars = Table(columns, dict.fromkeys(("length", "sigma"), "mm"), "bars.csv", (2,))
    result = run(net, off.lengths(), environment(std=5 * ONE_PPM), distances=bars)
    scale = next(one for one in result.estimates if one.name == "air.scale")
    assert scale.value - 1 == pytest.approx(2 * PPM, abs=2 * scale.std)
    assert scale.std < 0.5 * PPM


def test_lengths_to_a_machine_are_corrected_and_their_scale_is_uncertain() -> None:
    """One tool, so that no known distance between tools gives the scale."""
    rng, tool = np.random.default_rng(2), {"T1": (0.0, 0.0, 120.0)}
    machine = machines.random_machine(rng)
    table = of_machine.measured(machine, rng, n=120, tools=tool, noise=of_machine.MachineNoise(constant=1e-9))
    read = replace(table, columns={**table.columns, "length": table.numbers("length") * COLD / STANDARD})
    job = of_machine.settings(tool)

    def positioning(lengths: Table, air: Environment | None) -> tuple[np.ndarray, np.ndarray]:
        task = calibrate_machine.TASK.job(replace(job, environment=air), lengths=lengths)
        result = calibrate_machine.run(task)
        # the air is known to its uncertainty, so it makes no combination of errors undetermined
        assert float(str(result.statistics["ratio"])) < 20
        found = result.tables["tables/EXX"]
        return found.numbers("value"), found.numbers("std")

    expected, _ = positioning(table, None)
    found, std = positioning(read, environment(5.0, 1000.0))
    assert found == pytest.approx(expected, abs=3e-6)
    _, wider = positioning(read, environment(5.0, 1000.0, 10 * ONE_PPM_COLD))
    travel = float(machines.HIGH[0] - machines.LOW[0])
    assert np.sqrt(wider[-1] ** 2 - std[-1] ** 2) == pytest.approx(10 * PPM * travel, rel=0.03)


@pytest.mark.parametrize("method", ["adjustment", "closed-loop"])
def test_distances_of_a_launch_unit_are_corrected(method: str) -> None:
    """One direction only: the distance alone says how far the unit is."""
    unit = np.array([0.0, 0.0, 0.0])
    receivers = np.array([[4000.0, 0.0, 0.0], [4000.0, 1.0, 0.0], [4000.0, 0.0, 1.0]])
    exact = launch.poses(unit, 0.0, receivers, distances=True)
    assert exact.distance is not None
    table = replace(exact, distance=exact.distance * COLD / STANDARD).table()

    def found(std: float) -> Estimate:
        job = replace(launch.settings(method), environment=environment(5.0, 1000.0, std))
        return locate_launch_unit.run(locate_launch_unit.TASK.job(job, table)).estimates[0]

    assert found(0.0).value == pytest.approx(0.0, abs=1e-5)
    more = np.sqrt(found(5 * ONE_PPM_COLD).std ** 2 - found(0.0).std ** 2)
    assert more == pytest.approx(5 * PPM * 4000, rel=2e-3)


def test_an_entry_beside_its_column_is_said_to_be_unused() -> None:
    net = network(30, 5)
    lengths = in_air(net, 1.0)
    warm = replace(lengths, columns={**lengths.columns, "temp": np.full(len(lengths), 21.0)})
    words = [line for line in run(net, warm, environment(25.0)).warnings if "environment: the value of" in line]
    assert words == [f"environment: the value of temperature is not used, since {warm.file} has the column temp_degC"]
    only_std = replace(environment(), temperature=KnownQuantity(float("nan"), 0.1))
    for table, air in ((warm, only_std), (lengths, environment(25.0))):
        assert "is not used, since" not in " ".join(run(net, table, air).warnings)


def test_air_without_a_distance_is_warned_of() -> None:
    job = replace(launch.settings(), environment=environment(5.0, 1000.0))
    result = locate_launch_unit.run(locate_launch_unit.TASK.job(job, launch.anywhere(8, 3).table()))
    assert "poses.csv: no pose has a distance, so `environment:` changes nothing" in result.warnings


JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
environment: ENVIRONMENT
output: o.h5
"""
FULL = "{temperature: 21.3 degC, pressure: {value: 1003 hPa, std: 0.5 hPa}, humidity: 45 percent, correction: edlen}"
FAULTS = {
    "no humidity": ("{temperature: 21 degC, pressure: 1003 hPa}", "", ["the humidity of the air is missing", "lengths.csv"]),
    "two missing": ("{humidity: 40 percent}", "", ["the temperature of the air", "the pressure of the air"]),
    "too hot": (FULL.replace("21.3", "121.3"), "", ["job.yaml:5", "temperature: 121.3 degC is outside -40 to 100 degC"]),
    "bar": (FULL.replace("1003 hPa", "1003 bar"), "", ["job.yaml:5", "outside 100 to 1400 hPa"]),
    "no unit": (FULL.replace("45 percent", "45"), "", ["job.yaml:5", "has no unit"]),
    "unknown": (FULL.replace("edlen", "edlin"), "", ["did you mean 'edlen'"]),
    "all at once": (
        "{temperature: 21, humidity: 150 percent, pressure: 5 hPa, carbon_dioxide: 4 percent, wavelength: 3 um}", "",
        ["temperature: 21 has no unit", "humidity: 150 percent is outside 0 to 100", "pressure: 5 hPa is outside",
         "carbon_dioxide: 4 percent is outside", "wavelength: 3 um is outside 300 to 1700 nm"],
    ),
    "edlen": (FULL.replace("correction", "carbon_dioxide: 420 ppm, correction"), "", ["use `correction: ciddor`"]),
    "row": (FULL, "pressure_hPa", ["lengths.csv:4", "pressure: 1.003 is outside 100 to 1400 hPa"]),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    net = network(25, 5, seed=1)
    csv.write(tmp_path / "lengths.csv", net.lengths())
    csv.write(tmp_path / "points.csv", net.point_table())
    csv.write(tmp_path / "tracers.csv", net.tracer_table())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("case", FAULTS)
def test_faults_have_their_place(folder: Path, metrocli: Callable[..., Any], case: str) -> None:
    given, column, expected = FAULTS[case]
    (folder / "job.yaml").write_text(JOB.replace("ENVIRONMENT", given))
    if column:
        head, *rows = (folder / "lengths.csv").read_text().splitlines()
        rows = [f"{row},{'1.003' if i == 2 else '1003'}" for i, row in enumerate(rows)]
        (folder / "lengths.csv").write_text("\n".join([f"{head},{column}", *rows]) + "\n")
    ran = metrocli("check", "job.yaml")
    assert ran.code == 3
    for text in expected:
        assert text in ran.err


@pytest.mark.slow
def test_a_simulation_is_read_back_plan_and_diagnose_take_the_air(folder: Path, metrocli: Callable[..., Any]) -> None:
    job = JOB.replace("ENVIRONMENT", FULL.replace("0.5 hPa", "4 hPa"))
    job = job.replace("lengths: lengths.csv", "lengths: new/lengths.csv") + "simulation: {interval: 1 min}\n"
    (folder / "job.yaml").write_text(job)
    assert metrocli("simulate", "job.yaml", "--out", "new", "--seed", "3").code == 0
    ran = metrocli("multilaterate", "job.yaml")
    assert ran.code == 0, ran.err
    truth = csv.read(folder / "new/true_points.csv", POINTS)
    result = hdf5.read(folder / "o.h5")[0]
    apart = size(places(result.tables["points"])) / size(truth.stacked("xyz")) - 1
    assert abs(apart) < 4e-6
    assert metrocli("plan", "job.yaml", "--out", "planned").code == 0
    ran = metrocli("diagnose", "job.yaml", "--json")
    assert ran.code == 0
    assert '"verdict": "clean"' in ran.out
