"""Machines from lengths: the shared cases, exact recovery, intervals, words for what is open, and the planner."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from places import SHARED
from simulated import machine as sim
from simulated import machine_lengths as lengths

from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.diagnosis import noise_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise
from metrocli.tasks.calibrate_machine.plans.settings import PathPlan
from metrocli.tasks.calibrate_machine.rank.open_directions import line_of, stations_lie
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine, solve
from metrocli.tasks.calibrate_machine.tables import tables_of
from metrocli.tasks.calibrate_machine.volume import ToolErrors, predict
from metrocli.tasks.shared.lists import listed_places
from metrocli.tasks.shared.noise import DECLARED

Metrocli = Callable[..., Any]

CASES = SHARED / "cases" / "machine-lengths"
FOUND = sorted(CASES.iterdir()) if CASES.exists() else []
absent = pytest.mark.skipif(not FOUND, reason="../shared/cases/machine-lengths is not there")


def run(settings: Settings, table: Table, stations: Table | None = None) -> Result:
    return calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=table, stations=stations))


def rows_of(table: Table, rows: npt.NDArray[np.intp]) -> Table:
    lines = tuple(table.lines[i] for i in rows)
    return replace(table, columns={name: np.asarray(table.columns[name])[rows] for name in table.columns}, lines=lines)


def solved_of(settings: Settings, table: Table) -> AdjustedMachine:
    return solve(calibrate_machine.problem_of(calibrate_machine.TASK.job(settings, lengths=table)), False)


def predicted(solved: AdjustedMachine, at: sim.Array, tool: int) -> ToolErrors:
    tables = tables_of(solved.problem.machine, solved.solution)
    return predict(tables.machine, tables.blocks, (tables.unknowns, tables.raw), at.T, tool)[0]


@absent
@pytest.mark.alike
@pytest.mark.parametrize("case", FOUND, ids=lambda case: case.name)
def test_cases_that_another_program_simulated_come_out_right(case: Path) -> None:
    job, truth = load(case / "job.yaml"), json.loads((case / "truth.json").read_text())
    task = calibrate_machine.TASK.job(job.settings, **read_inputs(job))
    solved = solve(calibrate_machine.problem_of(task), False)
    result = calibrate_machine.report(solved, job.settings, noise_of(solved, DECLARED, 1.0))
    statistics = result.statistics
    assert statistics["possible_rank"] - statistics["rank"] == truth["undetermined"]["directions"]
    open_ones = set(f"{statistics['undetermined']} {statistics['together']}".split())
    assert open_ones == set(truth["undetermined"]["moved"])
    scores = []
    for name, table in truth["tables"].items():
        if name not in open_ones:
            found = result.tables[f"tables/{name}"]
            std, off = found.numbers("std"), found.numbers("value") - table["value"]
            scores.append(off[std > 1e-15] / std[std > 1e-15])
    z = np.concatenate(scores)
    assert np.abs(z).max() < 4
    assert (np.abs(z) < 1.96).mean() > 0.9
    assert statistics["sigma0"] == pytest.approx(1, abs=0.08)
    names, reference = list(job.settings.tools), truth["reference"]
    tool = np.array([names.index(name) if len(names) > 1 else 0 for name in reference["tool"]])
    at, true = np.array(reference["commanded"]), np.array(reference["error_mm"])
    for which in np.unique(tool):
        found = predicted(solved, at[tool == which], int(which))
        miss = found.error.T - true[tool == which]
        assert np.sqrt(((miss / found.std.T) ** 2).mean()) < 1.5
        assert np.linalg.norm(miss, axis=1).mean() < 0.02 * truth["reference"]["mean_error_mm"]


def test_gross_lengths_are_no_repeatability() -> None:
    """Two lengths that were exchanged and one off by 10 mm are left out before its size is estimated."""
    rng = np.random.default_rng(37)
    table = lengths.measured(sim.random_machine(rng), rng, 120, repeatability=2e-3)
    length = table.numbers("length").copy()
    length[[10, 60]] = length[[60, 10]]
    length[300] += 10.0
    spoilt = replace(table, columns={**table.columns, "length": length})
    noise = replace(lengths.NOISE, repeatability="estimated")
    result = run(lengths.settings(noise=noise, outliers="remove"), spoilt)
    assert set(result.tables["rejected"].texts("point")) == {"P10 at S1", "P60 at S1", "P60 at S3"}
    assert result.statistics["repeatability"] == pytest.approx(2e-3, rel=0.1)
    (left_out,) = (line for line in result.warnings if "left out as wrong" in line)
    assert left_out.startswith("3 readings are") and "point P60 at S3 (w = " in left_out


@pytest.mark.parametrize("repeatability", [2e-3, "estimated"])
def test_lengths_off_by_metres_are_named_and_left_out(repeatability: float | str) -> None:
    """Least squares carries a station away with them: the refusal named its place as what is not determined."""
    rng = np.random.default_rng(38)
    table = lengths.measured(sim.random_machine(rng), rng, 120, repeatability=2e-3)
    length = table.numbers("length").copy()
    length[[10, 300]] += np.array([3000.0, -3000.0])
    spoilt = replace(table, columns={**table.columns, "length": length})
    noise = replace(lengths.NOISE, repeatability=repeatability)
    with pytest.raises(NotConvergedError, match=r"without point P60 at S3, point P10 at S1 the others have a solution"):
        run(lengths.settings(noise=noise), spoilt)
    result = run(lengths.settings(noise=noise, outliers="remove"), spoilt)
    (line,) = (line for line in result.warnings if "left out as wrong" in line)
    assert line.startswith("2 readings are left out as wrong: point P60 at S3 (w > 1e+06)")
    assert result.statistics["sigma0"] == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("seed", [0, 2])
def test_wrong_lengths_do_not_hide_each_other(seed: int) -> None:
    """A twelfth of few lengths off by 20 to 60 sigma: sigma0 was 9 and 11, and most of them stayed."""
    rng = np.random.default_rng(seed)
    table = lengths.measured(sim.random_machine(rng), rng, 42)
    length = table.numbers("length").copy()
    wrong = rng.random(len(length)) < 0.08
    off = 0.3e-3 * rng.uniform(20, 60, len(length)) * rng.choice([-1, 1], len(length))
    spoilt = replace(table, columns={**table.columns, "length": length + np.where(wrong, off, 0.0)})
    result = run(lengths.settings(outliers="remove"), spoilt)
    assert result.statistics["sigma0"] < 1.2
    assert wrong.sum() <= len(result.tables["rejected"]) <= wrong.sum() + 2


def test_no_length_is_gross_where_few_are_redundant() -> None:
    """A robust fit meets most of them exactly, so that the others are many of their median from it."""
    rng = np.random.default_rng(20)
    table = lengths.measured(sim.random_machine(rng), rng, 60, repeatability=2e-3)
    few = rows_of(table, np.sort(rng.permutation(len(table))[:90]))
    noise = replace(lengths.NOISE, repeatability="estimated")
    result = run(lengths.settings(noise=noise, outliers="remove"), few)
    assert len(result.tables["rejected"]) == 0 and result.statistics["repeatability"] < 6e-3


@pytest.mark.parametrize("order", ["XYZ", "YXZ"])
def test_without_noise_the_error_of_both_tools_is_recovered_to_a_nanometre(order: str) -> None:
    rng = np.random.default_rng(31)
    machine = sim.random_machine(rng, order)
    table = lengths.measured(machine, rng, noise=MachineNoise(constant=0.0), stations=lengths.STATIONS)
    settings = lengths.settings()
    settings = replace(settings, machine=replace(settings.machine, chain=order))
    solved = solved_of(settings, table)
    at = rng.uniform(sim.LOW, sim.HIGH, (200, 3))
    for tool, vector in enumerate(lengths.TWO.values()):
        true = sim.displacements(machine, at, np.array(vector))
        assert np.abs(predicted(solved, at, tool).error.T - true).max() < 1e-6
        assert np.linalg.norm(true, axis=1).mean() > 0.03


def test_listed_stations_change_nothing() -> None:
    rng = np.random.default_rng(32)
    machine = sim.random_machine(rng)
    table = lengths.measured(machine, rng, 100)
    near = lengths.listed(np.round(lengths.STATIONS[:4] + rng.normal(size=(4, 3)) * 20, 0))
    one, other = run(lengths.settings(), table), run(lengths.settings(), table, near)
    for name in ("EXX", "ECY", "EZY"):
        assert one.tables[f"tables/{name}"].numbers("value") == pytest.approx(
            other.tables[f"tables/{name}"].numbers("value"), abs=1e-9
        )
    places = one.tables["stations"].stacked("xyz")
    assert np.abs(places - lengths.STATIONS[:4]).max() < 0.05
    assert (np.abs(places - lengths.STATIONS[:4]) < 5 * one.tables["stations"].stacked(("sx", "sy", "sz"))).all()


def test_lengths_and_a_tracker_agree_on_the_same_machine() -> None:
    """The joint test of the difference at points all over the volume, after the best shift and turn."""
    rng = np.random.default_rng(33)
    machine = sim.random_machine(rng)
    by_lengths = solved_of(lengths.settings(sim.THREE), lengths.measured(machine, rng, 250, sim.THREE))
    job = calibrate_machine.TASK.job(sim.settings(tools=sim.THREE), points=sim.points(machine, rng, 300, sim.THREE))
    by_tracker = solve(calibrate_machine.problem_of(job), False)
    scores = []
    for solved, other in ((by_lengths, by_tracker),):
        one, two = (tables_of(part.problem.machine, part.solution) for part in (solved, other))
        covariance = one.covariance + two.covariance
        known = np.diag(covariance) > 1e-24
        difference = (one.values - two.values)[known]
        values, vectors = np.linalg.eigh(
            covariance[np.ix_(known, known)] / np.outer(*(np.sqrt(np.diag(covariance)[known]),) * 2)
        )
        z = vectors.T @ (difference / np.sqrt(np.diag(covariance)[known]))
        good = values > 1e-9
        scores = z[good] / np.sqrt(values[good])
    n = len(scores)
    assert n > 60
    assert abs((scores**2).sum() - n) < 3.5 * np.sqrt(2 * n)


def test_intervals_contain_the_truth() -> None:
    inside = []
    for seed in range(4):
        rng = np.random.default_rng(400 + seed)
        machine = sim.random_machine(rng)
        solved = solved_of(lengths.settings(sim.THREE), lengths.measured(machine, rng, 120, sim.THREE))
        at = rng.uniform(sim.LOW, sim.HIGH, (60, 3))
        found = predicted(solved, at, 0)
        true = sim.displacements(machine, at, np.array(sim.THREE["T1"])).T
        inside.append(np.abs(found.error - true) < 1.96 * found.std)
    assert 0.91 < np.mean(inside) < 0.985


def test_one_tool_leaves_four_tables_open_and_another_tool_is_not_predicted() -> None:
    rng = np.random.default_rng(35)
    machine = sim.random_machine(rng)
    two = {"T1": (0.0, 0.0, 120.0), "T2": (80.0, 0.0, 60.0)}
    table = lengths.measured(machine, rng, tools={"T1": two["T1"]})
    result = run(lengths.settings(two), table)
    assert set(result.statistics["undetermined"].split()) == {"ECY", "EAZ", "EBZ", "ECZ"}
    assert set(result.statistics["together"].split()) == {"EXZ", "EYZ", "A0Z", "B0Z"}
    warnings = " ".join(result.warnings)
    assert "it has one tool" in warnings
    assert "error of tool T2 cannot be predicted" in warnings
    solved = solved_of(lengths.settings(two), table)
    at = rng.uniform(sim.LOW, sim.HIGH, (100, 3))
    found = predicted(solved, at, 0)
    miss = found.error.T - sim.displacements(machine, at, np.array(two["T1"]))
    assert np.sqrt(((miss / found.std.T) ** 2).mean()) == pytest.approx(1, abs=0.35)


@pytest.mark.alike
@pytest.mark.parametrize("together", [False, True])
def test_the_repeatability_is_estimated_with_its_uncertainty(together: bool) -> None:
    scores, z = [], []
    for seed in range(2):
        rng = np.random.default_rng(500 + seed)
        machine = sim.random_machine(rng)
        table = lengths.measured(machine, rng, 90, sim.THREE, repeatability=1e-3, together=together)
        noise = replace(lengths.NOISE, repeatability="estimated")
        result = run(lengths.settings(sim.THREE, noise=noise), table)
        statistics = result.statistics
        scores.append((statistics["repeatability"] - 1e-3) / statistics["repeatability_std"])
        assert statistics["repeatability_std"] < 1e-4
        assert statistics["sigma0"] == pytest.approx(1, abs=0.12)
        for name in sim.NAMES:
            found = result.tables[f"tables/{name}"]
            std = found.numbers("std")
            z.append(((found.numbers("value") - machine.tables[name]) / np.maximum(std, 1e-30))[std > 1e-12])
    assert np.abs(scores).max() < 3.5
    assert np.sqrt((np.concatenate(z) ** 2).mean()) == pytest.approx(1, abs=0.2)


def test_lengths_of_one_stop_share_its_deviation() -> None:
    """Against generalised least squares with the full covariance of the lengths, for a machine with few unknowns."""
    rng = np.random.default_rng(36)
    machine = sim.Machine("XYZ", (5, 5, 5), {name: np.zeros(5) for name in sim.NAMES}, (2e-5, 0.0, 0.0))
    r = 1e-3
    table = lengths.measured(machine, rng, 40, sim.ONE, repeatability=r, together=True)
    noise = replace(lengths.NOISE, repeatability=r)
    result = run(lengths.settings(sim.ONE, noise=noise, estimate=("A0Z",)), table)
    m, n = 4, 40
    position = table.stacked("xyz")[:n] + np.array(sim.ONE["T1"])
    stations = result.tables["stations"].stacked("xyz")
    beam = position[None] - stations[:, None]
    path = np.linalg.norm(beam, axis=2)
    u = beam / path[..., None]
    design = np.zeros((m, n, 1 + 4 * m))
    design[..., 0] = -u[..., 1] * table.numbers("z")[:n]
    for j in range(m):
        design[j, :, 1 + 4 * j : 4 + 4 * j], design[j, :, 4 + 4 * j] = -u[j], -1.0
    flat = design.reshape(m * n, -1)
    covariance = np.diag((0.3e-3**2 + (1e-7 * path) ** 2).ravel())
    for i in range(n):
        at = np.arange(m) * n + i
        covariance[np.ix_(at, at)] += r**2 * u[:, i] @ u[:, i].T
    q = np.linalg.inv(flat.T @ np.linalg.solve(covariance, flat))
    assert result.estimates[0].std == pytest.approx(np.sqrt(q[0, 0]), rel=1e-3)


def test_without_a_repeatability_the_warning_says_how_to_estimate_it() -> None:
    rng = np.random.default_rng(37)
    table = lengths.measured(sim.random_machine(rng), rng, repeatability=1e-3)
    assert any("repeatability: estimated" in warning for warning in run(lengths.settings(), table).warnings)


def test_one_station_is_refused_and_the_cure_is_named() -> None:
    rng = np.random.default_rng(38)
    table = lengths.measured(sim.random_machine(rng), rng, 400, stations=lengths.STATIONS[:1])
    with pytest.raises(UndeterminedError, match=r"(?s)E[A-Z]{2} at .*there is only one station: add stations"):
        run(lengths.settings(), table)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_rough_places_of_stations_show_an_axis_that_counts_backwards(axis: str) -> None:
    rng = np.random.default_rng(3011)
    table = lengths.measured(sim.random_machine(rng), rng, 100, sim.ONE)
    rough = lengths.listed(lengths.STATIONS[:4] + rng.uniform(-60, 60, (4, 3)))
    rough = replace(rough, columns={**rough.columns, "sigma": np.full(4, np.nan)})
    run(lengths.settings(tools=sim.ONE), table, rough)
    ends = dict(zip("xyz", sim.LOW + sim.HIGH, strict=True))
    backwards = replace(table, columns={**table.columns, axis: ends[axis] - table.numbers(axis)})
    with pytest.raises(InputError, match=f"{axis.upper()} counts the other way"):
        run(lengths.settings(tools=sim.ONE), backwards, rough)


def test_stations_and_tools_on_a_line_or_in_a_plane_are_named() -> None:
    assert stations_lie(lengths.STATIONS) == ""
    assert stations_lie(lengths.STATIONS * [1, 1, 0]) == "the 5 stations lie in one plane"
    assert stations_lie(np.outer([1.0, 2, 5], [3.0, 1, 2])) == "the 3 stations lie on one line"
    assert line_of(np.array([[0.0, 0, 120], [80, 0, 60]])) == pytest.approx([0.8, 0, -0.6])
    assert line_of(np.array(list(sim.THREE.values()))) is None
    assert line_of(np.array([[0.0, 0, 120]])) is None


def test_wrong_files_are_refused_with_their_cause() -> None:
    rng = np.random.default_rng(39)
    table = lengths.measured(sim.random_machine(rng), rng, 60)
    turned = replace(table, columns={**table.columns, "length": -table.numbers("length")})
    with pytest.raises(InputError, match="fit with the other sign"):
        run(lengths.settings(), turned)
    known = lengths.listed(lengths.STATIONS[:3])
    with pytest.raises(InputError, match="lengths.csv:182: error: station 'S4' is not in stations.csv"):
        run(lengths.settings(), table, known)
    few = lengths.measured(sim.random_machine(rng), rng, 60)
    keep = np.flatnonzero((np.array(few.texts("station")) != "S2") | (np.arange(240) < 63))
    with pytest.raises(UndeterminedError, match="station S2 reads 3 points"):
        run(lengths.settings(), rows_of(few, keep))


def test_the_plan_keeps_its_promise_in_its_time() -> None:
    settings = lengths.settings(plan=PathPlan(time=3 * 3600.0))
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings))
    figures = {figure.name: figure.value for figure in plan.figures}
    assert figures["duration"] <= 3 * 3600.0
    points, stations = plan.files["points.csv"], plan.files["stations.csv"]
    assert isinstance(points, Table) and isinstance(stations, Table)
    assert len(stations) == figures["stations"] >= 3
    n, m = len(points), len(stations)
    machine, rng = sim.random_machine(np.random.default_rng(40)), np.random.default_rng(41)
    vectors = np.array([lengths.TWO[name] for name in points.texts("tool")])
    reached = points.stacked("xyz") + vectors + sim.displacements(machine, points.stacked("xyz"), vectors)
    path = np.linalg.norm(reached - stations.stacked("xyz")[:, None], axis=2)
    read = path - 300 + rng.normal(size=path.shape) * np.sqrt(0.3e-3**2 + (1e-7 * path) ** 2)
    columns = {name: np.tile(np.asarray(values), m) for name, values in points.columns.items()}
    columns |= {"station": np.repeat(stations.texts("station"), n), "length": read.ravel()}
    table = Table(columns, {**points.units, "length": "mm"}, "lengths.csv", tuple(range(2, m * n + 2)))
    result = run(settings, table)
    assert result.tables["volumetric"].numbers("uncertainty").mean() == pytest.approx(figures["uncertainty"], rel=0.02)


def test_a_wanted_uncertainty_takes_less_time() -> None:
    wanted = PathPlan(time=6 * 3600.0, uncertainty=0.5e-3)
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(lengths.settings(plan=wanted)))
    figures = {figure.name: figure.value for figure in plan.figures}
    assert figures["uncertainty"] <= 0.5e-3
    assert figures["duration"] < 3 * 3600.0
    with pytest.raises(UndeterminedError, match="too short for three stations"):
        calibrate_machine.plan(calibrate_machine.TASK.job(lengths.settings(plan=PathPlan(time=1800.0))))


def test_stations_are_those_of_a_network() -> None:
    points = listed_places("point", ["L2", "P1"], np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    stations = listed_places("station", ["L1", "S9"], np.array([[7.0, 8.0, 9.0], [0.0, 0.0, 0.0]]))
    network = Result("adjust-network", "", (), np.zeros((0, 0)), {}, {"points": points, "stations": stations})
    read = Table({"station": np.array(["L1", "L2"])})
    found = Files(stations=network, lengths=read).listed_stations
    assert found is not None and found.texts("station") == ["L2", "L1"]
    assert found.stacked("xyz").tolist() == [[1.0, 2.0, 3.0], [7.0, 8.0, 9.0]]


@pytest.mark.parametrize("key", ["correlated", "variance_groups"])
def test_places_by_the_name_of_their_column_are_named(key: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """All kinds of places were listed, also those that the readings have not, and none as the one that is meant."""
    entry = {
        "correlated": "{covariate: t_s, by: station, length: 0.25, std: 1 um}",
        "variance_groups": "{by: station, only: S1, ratio: 2}",
    }
    metrocli("init", tmp_path / "p", "--sample", "machine-lengths")
    ran = metrocli("check", tmp_path / "p" / "jobs" / "lengths.yaml", "--set", f"{key}=[{entry[key]}]")
    assert ran.code == 3 and "write by: tracer, which has the names in the column 'station'" in ran.err
