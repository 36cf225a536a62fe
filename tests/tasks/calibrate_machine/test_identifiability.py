"""What a measurement determines: the numbers of open directions for chains and tools, and their names."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.instruments.machine_path import Path
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.methods.standstill import standstill
from metrocli.tasks.calibrate_machine.plans.path_search import edges_and_diagonals
from metrocli.tasks.calibrate_machine.plans.planned import planned_problem
from metrocli.tasks.calibrate_machine.rank.identifiability import Identifiability, identify

KNOTS = (13, 11, 11)
ALONG_Z = {"T1": (0.0, 0.0, 120.0), "T2": (0.0, 0.0, 220.0)}
SKEW = {"T1": (0.0, 0.0, 120.0), "T2": (80.0, 30.0, 150.0)}


def identified(order: str, tools: dict[str, tuple[float, ...]], knots: tuple[int, int, int] = KNOTS) -> Identifiability:
    rng = np.random.default_rng(1)
    machine = sim.random_machine(rng, order, knots)
    return identify(
        standstill(sim.settings(tools=tools, knots=knots, chain=order), sim.points(machine, rng, 300, tools))
    )


@pytest.mark.alike
@pytest.mark.parametrize(
    ("tools", "missing"),
    [(sim.ONE, 40), (ALONG_Z, 20), (SKEW, 10), (sim.THREE, 0)],
    ids=["one", "along z", "skew", "three"],
)
def test_open_directions_by_tools(tools: dict[str, tuple[float, ...]], missing: int) -> None:
    """One tool leaves four tables of ten unknowns each; three tools that are not in line leave nothing."""
    found = identified("XYZ", tools)
    assert found.unknowns - found.rank == missing


def test_one_tool_on_xyz() -> None:
    found = identified("XYZ", sim.ONE)
    assert set(found.undetermined) == {"EAZ", "EBZ", "ECZ", "ECY"}
    assert set(found.together) == {"EXZ", "EYZ", "A0Z", "B0Z"}
    # a tool along z: the angles about it move nothing at all
    assert found.partners["ECZ"] == found.partners["ECY"] == ()
    assert set(found.partners["EAZ"]) == {"EYZ", "A0Z"}
    assert found.open_tools == ()


@pytest.mark.alike
@pytest.mark.parametrize("order", ["".join(order) for order in permutations("XYZ")])
def test_one_tool_leaves_the_angles_of_the_last_axis_and_one_of_the_next(order: str) -> None:
    """The three angles of the axis nearest to the tool, and the next axis' angle about that axis' direction."""
    found = identified(order, sim.ONE)
    _, next_to_last, last = order
    about = "ABC"["XYZ".index(last)]
    assert set(found.undetermined) == {f"E{angle}{last}" for angle in "ABC"} | {f"E{about}{next_to_last}"}


def test_knots_of_the_open_tables_are_counted() -> None:
    """YXZ and ZXY: the roll of X has two knots more than Y's."""
    for order in ("YXZ", "ZXY"):
        found = identified(order, sim.ONE)
        assert found.unknowns - found.rank == 42


def planned(path: Path, knots: tuple[int, int, int]) -> Identifiability:
    settings = replace(sim.settings("on-the-fly", knots=knots), corner=0.0)
    return identify(planned_problem(settings, path))


def test_edges_and_diagonals_with_equal_knots_leave_four_combinations_that_move_the_volume() -> None:
    path = edges_and_diagonals(machine_of(sim.settings("on-the-fly", knots=(11, 11, 11))))
    with pytest.raises(UndeterminedError) as told:
        planned(path, (11, 11, 11))
    text = str(told.value)
    assert text.startswith("the measurement does not determine 4 combinations of errors that move the tool")
    lines = [line for line in text.splitlines() if line.startswith("  ")]
    assert len(lines) == 4
    # positioning in common along the diagonals
    assert all(
        {"EXX", "EYY", "EZZ"} <= {part.split()[0] for part in line.split(": ", 1)[1].replace("mm, ", "|").split("|")}
        for line in lines
    )


def test_a_path_of_edges_and_diagonals_says_little_of_the_volume() -> None:
    """The published figure for this path is 157."""
    machine = machine_of(sim.settings("on-the-fly", knots=KNOTS))
    path = edges_and_diagonals(machine)
    assert len(path.lengths) == 31
    assert path.length == pytest.approx(21000, rel=0.01)
    assert planned(path, KNOTS).ratio == pytest.approx(157, rel=0.02)


def test_an_open_combination_does_not_move_the_tool_it_was_measured_with() -> None:
    """Two machines that differ in an open direction: different tables, the same error of that tool, not of another."""
    rng = np.random.default_rng(7)
    machine = sim.random_machine(rng)
    pitch = machine.tables["EBZ"] * 3 + 1e-4 * np.sin(machine.positions("Z"))
    pitch -= np.interp(0.0, machine.positions("Z"), pitch)
    change = pitch - machine.tables["EBZ"]
    shift = -120.0 * change
    slope = (shift[-1] - shift[0]) / 500.0
    level = shift - shift[0] - slope * (machine.positions("Z") + 500.0)
    tables = {**machine.tables, "EBZ": pitch, "EXZ": machine.tables["EXZ"] + level}
    a, b, c = machine.squareness
    other = sim.Machine("XYZ", (5, 5, 5), tables, (a, b + slope, c))
    positions = sim.commands(rng, 30)
    for tool, same in ((sim.ONE["T1"], True), ((0.0, 0.0, 220.0), False)):
        d = [np.array([one.first_order(p, np.array(tool)) for p in positions]) for one in (machine, other)]
        apart = d[1] - d[0]
        apart -= apart.mean(axis=0)
        assert (np.abs(apart).max() < 1e-12) == same


def test_the_tool_of_the_measurement_is_predicted_and_another_is_refused() -> None:
    rng = np.random.default_rng(8)
    tools = {**sim.ONE, "LONG": (0.0, 0.0, 220.0)}
    machine = sim.random_machine(rng)
    table = sim.points(machine, rng, 200, sim.ONE)
    result = calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(tools=tools), points=table))
    volume = result.tables["volume"]
    names = np.array(volume.texts("tool"))
    own = predicted(result.tables["volume"], names == "T1")
    truth = np.array([machine.first_order(p, np.array(tools["T1"])) for p in own[0]])
    # tables of the job and of the truth differ by what cannot be told, a rigid motion and a shift: compare the shape
    apart = sim.without_motion(own[1] - truth, own[0])
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 0.004
    assert np.isnan(volume.numbers("ex")[names == "LONG"]).all()
    assert np.isinf(volume.numbers("s_ex")[names == "LONG"]).all()
    assert dict(
        zip(result.tables["tools"].texts("tool"), result.tables["tools"].columns["predictable"].tolist(), strict=True)
    ) == {"T1": True, "LONG": False}
    assert any("tool LONG cannot be predicted" in line for line in result.warnings)
    assert any("EAZ EBZ ECZ" in line or "ECY EAZ" in line for line in result.warnings)


def predicted(volume, rows) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
    return volume.stacked("xyz")[rows], volume.stacked(("ex", "ey", "ez"))[rows]


def test_what_is_not_determined_has_no_number() -> None:
    rng = np.random.default_rng(9)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(sim.settings(), points=sim.points(sim.random_machine(rng), rng, 200))
    )
    assert result.statistics["undetermined"] == "ECY EAZ EBZ ECZ"
    assert result.statistics["together"] == "EXZ EYZ A0Z B0Z"
    for name in sim.NAMES:
        table = result.tables[f"tables/{name}"]
        open_one = name in ("ECY", "EAZ", "EBZ", "ECZ")
        assert np.isnan(table.numbers("value")).all() == open_one
        assert np.isinf(table.numbers("std")).all() == open_one


def test_the_ratio_is_that_of_the_worst_machine_that_can_be_thought_of() -> None:
    """No random change of the unknowns has a larger ratio; the worst one has it."""
    from metrocli.adjust.dense_jacobian import rows, unit_noise, unknowns_of
    from metrocli.tasks.calibrate_machine.rank.identifiability import volume_matrix

    rng = np.random.default_rng(10)
    table = sim.points(sim.random_machine(rng), rng, 60)
    problem = standstill(
        sim.settings(tools=sim.ONE, knots=(3, 3, 3)), sim.points(sim.random_machine(rng, knots=(3, 3, 3)), rng, 60)
    )
    assert len(table) == 60
    found = identify(problem)
    held = problem.with_blocks(found.blocks)
    unknowns = unknowns_of(found.blocks, [name for name, block in found.blocks.items() if block.free.any()])
    seen = rows(unit_noise(problem.readings), found.blocks, unknowns)
    volume = volume_matrix(held, unknowns)
    directions = rng.normal(size=(unknowns.size, 2000)) * unknowns.reach(found.blocks)[:, None]
    path = np.sqrt(((seen @ directions) ** 2).sum(axis=0).mean(axis=0))
    ratios = np.sqrt(np.einsum("ik,ij,jk->k", directions, volume, directions)) / path
    assert ratios.max() <= found.ratio
    best = directions[:, np.argmax(ratios)]
    for _ in range(300):
        # a climb by hand: gradient of the ratio of two quadratic forms
        normal = np.einsum("ani,anj->ij", seen, seen) / problem.readings.observations.count
        best = np.linalg.solve(normal, volume @ best)
        best /= np.linalg.norm(best)
    assert np.sqrt((best @ volume @ best) / (best @ normal @ best)) == pytest.approx(found.ratio, rel=1e-4)
