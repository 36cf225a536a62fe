"""The planner: a path, points or lines with the ratio wanted, and what it promises comes true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exports import nc_interpreter as nc_interpreter
from simulated import machine as sim

from metrocli.instruments.machine_path import Path
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise
from metrocli.tasks.calibrate_machine.plans.path_search import edges_and_diagonals
from metrocli.tasks.calibrate_machine.plans.planned import planned_problem
from metrocli.tasks.calibrate_machine.plans.settings import PathPlan
from metrocli.tasks.calibrate_machine.rank.identifiability import identify
from metrocli.tasks.calibrate_machine.settings import MachineSimulation

NOISE = MachineNoise(beam=1e-3, lateral=5e-3)


@pytest.mark.parametrize(
    "knots",
    [(11, 11, 11), *(pytest.param(knots, marks=pytest.mark.slow) for knots in ((13, 11, 11), (25, 21, 21)))],
)
def test_the_path_reaches_the_ratio_within_the_length(knots: tuple[int, int, int]) -> None:
    settings = sim.settings("on-the-fly", knots=knots, noise=NOISE)
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings))
    figures = {estimate.name: estimate.value for estimate in plan.figures}
    assert figures["ratio"] <= 4.0
    assert figures["path_length"] <= edges_and_diagonals(machine_of(settings)).length
    assert plan.warnings == ()
    # the file itself has this ratio
    vertices = plan.files["path.csv"].stacked("xyz")  # type: ignore[union-attr]
    again = identify(planned_problem(settings, Path.of(vertices, np.zeros(len(vertices), dtype=int))))
    assert again.ratio == pytest.approx(figures["ratio"])


def test_the_promised_uncertainty_is_that_of_the_measurement() -> None:
    settings = sim.settings("on-the-fly", knots=(5, 5, 5), noise=NOISE)
    settings = replace(settings, plan=PathPlan(feed=40.0, sampling=0.05, tracker=(-900.0, -700.0, 200.0)))
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings))
    vertices = plan.files["path.csv"].stacked("xyz")  # type: ignore[union-attr]
    machine = sim.random_machine(np.random.default_rng(61))
    flight = sim.flight(machine, vertices, np.random.default_rng(62), spacing=2.0)
    result = calibrate_machine.run(calibrate_machine.TASK.job(settings, path=flight.path, track=flight.track))
    promised = dict(
        zip(plan.tables["errors"].texts("error"), plan.tables["errors"].numbers("largest_std"), strict=True)
    )
    found = dict(
        zip(result.tables["errors"].texts("error"), result.tables["errors"].numbers("largest_std"), strict=True)
    )
    ratios = [found[name] / promised[name] for name in promised if np.isfinite(promised[name])]
    assert len(ratios) == 17
    assert min(ratios) > 0.8 and max(ratios) < 1.25


@pytest.mark.slow
def test_three_tools_share_the_path() -> None:
    settings = sim.settings("on-the-fly", tools=sim.THREE, knots=(7, 6, 6), noise=NOISE)
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings))
    table = plan.files["path.csv"]
    assert list(dict.fromkeys(table.texts("tool"))) == ["T1", "T2", "T3"]  # type: ignore[union-attr]
    assert all(status == "determined" for status in plan.tables["errors"].texts("status"))
    assert plan.figures[0].value <= 4.0


def test_the_program_drives_the_path() -> None:
    settings = sim.settings("on-the-fly", tools=sim.THREE, knots=(5, 5, 5), noise=NOISE)
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings))
    vertices = plan.files["path.csv"].stacked("xyz")  # type: ignore[union-attr]
    tool = np.array(plan.files["path.csv"].texts("tool"))  # type: ignore[union-attr]
    path = Path.of(vertices, np.unique(tool, return_inverse=True)[1])
    done = nc_interpreter.run(str(plan.files["path.nc"]), np.zeros(3))
    assert done.stops == 3
    assert "mount reflector T2" in done.comments
    assert len(done.feeds) == len(path.lengths)
    assert np.allclose([begin for begin, _, _ in done.feeds], path.start, atol=1e-4)
    assert np.allclose([end for _, end, _ in done.feeds], path.end, atol=1e-4)
    assert {feed for _, _, feed in done.feeds} == {40.0 * 60}


def test_the_jobs_own_path_is_judged() -> None:
    settings = sim.settings("on-the-fly", knots=(11, 11, 11), noise=NOISE)
    lines = edges_and_diagonals(machine_of(settings))
    table = sim.coordinate_table(
        "path.csv", np.concatenate([[lines.start[0], lines.end[0]], [lines.start[1], lines.end[1]]]), {}
    )
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings, path=table))
    assert plan.notes[0].startswith("the path of the job: 3 legs")
    assert any("combinations of errors that move" in line or "no reading is near" in line for line in plan.notes)


def test_a_length_that_is_too_short_is_said() -> None:
    settings = sim.settings("on-the-fly", knots=(7, 7, 7), noise=NOISE)
    plan = calibrate_machine.plan(
        calibrate_machine.TASK.job(replace(settings, plan=PathPlan(length=9000.0, ratio=1.5)))
    )
    assert any("allow a longer path" in line for line in plan.warnings)


def promised_over_found(plan: Plan, result: Result) -> list[float]:
    """Largest standard uncertainties of the errors: of the measurement over those of the plan."""
    listed_at, got = plan.tables["errors"], result.tables["errors"]
    assert listed_at.texts("error") == got.texts("error")
    return (got.numbers("largest_std") / listed_at.numbers("largest_std")).tolist()


def test_points_are_planned_and_keep_their_promise() -> None:
    """As few as reach the ratio, each tool all over the volume; at a third of them not all is determined."""
    settings = replace(
        sim.settings(tools=sim.THREE, knots=(7, 6, 6), noise=NOISE), plan=PathPlan(tracker=(-900.0, -700.0, 200.0))
    )
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(settings))
    figures = {estimate.name: estimate.value for estimate in plan.figures}
    assert figures["ratio"] <= 4.0 and plan.warnings == ()
    assert set(plan.tables["errors"].texts("status")) == {"determined"}
    points = plan.files["points.csv"]
    assert isinstance(points, Table) and len(points) == figures["points"] < 120
    done = nc_interpreter.run(str(plan.files["points.nc"]), np.zeros(3))
    assert done.stops == 3
    assert np.allclose([at for at, _ in done.dwells], points.stacked("xyz"), atol=1e-4)
    rng = np.random.default_rng(63)
    machine = sim.random_machine(rng, knots=(7, 6, 6))
    at, tool = points.stacked("xyz"), np.array(points.texts("tool"))
    vectors = np.array([sim.THREE[name] for name in tool])
    seen = sim.tracker(rng).reads(sim.reached(machine, at, vectors), rng, 1.0)
    ratios = promised_over_found(
        plan, calibrate_machine.run(calibrate_machine.TASK.job(settings, points=sim.point_table(at, seen, tool)))
    )
    assert min(ratios) > 0.8 and max(ratios) < 1.25
    fewer = calibrate_machine.plan(
        calibrate_machine.TASK.job(settings, points=sim.point_table(at[::3], seen[::3], tool[::3]))
    )
    assert any("combinations of errors that move" in line or "no reading is near" in line for line in fewer.notes)


def test_lines_of_a_laser_are_planned_and_keep_their_promise() -> None:
    settings = sim.settings(
        "six-dof", tools={"": (0.0, 0.0, 0.0)}, noise=MachineNoise(displacement=5e-4, straightness=1e-3, angle=1e-6)
    )
    plan = calibrate_machine.plan(calibrate_machine.TASK.job(replace(settings, plan=PathPlan(control="siemens"))))
    lines = plan.files["lines.csv"]
    assert isinstance(lines, Table)
    assert list(dict.fromkeys(lines.texts("line"))) == ["x", "y", "z", "xy", "yz", "xz"]
    done = nc_interpreter.run(str(plan.files["lines.nc"]), np.zeros(3), "siemens")
    assert done.stops == 6
    assert np.allclose([at for at, _ in done.dwells], lines.stacked("xyz"), atol=1e-4)
    simulated = calibrate_machine.simulate(
        calibrate_machine.TASK.job(replace(settings, simulation=MachineSimulation(error=0.05))),
        SimulationOptions(3, False),
    )
    ratios = promised_over_found(
        plan, calibrate_machine.run(calibrate_machine.TASK.job(settings, lines=simulated.files["lines.csv"]))
    )
    assert max(abs(ratio - 1) for ratio in ratios) < 1e-6
