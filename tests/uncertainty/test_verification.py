"""A result against independent measurements: figures of plain numpy, true machines, and planted wrong points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri
from simulated import machine as sim
from simulated.lengths import network
from simulated.lengths import settings as of_lengths

from metrocli.errors import InputError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.uncertainty.numbers import COVERAGE, factor
from metrocli.uncertainty.verification import columns_for, verify

SIGMA = 1.5e-3
HERE, TURN = np.array([400.0, -900.0, 250.0]), sim.rotation(np.array([0.3, -0.5, 1.1]))


def calibrated(machine: sim.Machine, seed: int, tools: dict[str, tuple[float, float, float]]) -> Result:
    points = sim.points(machine, np.random.default_rng(seed), 150, tools)
    settings = sim.settings(tools=tools, knots=machine.knots)
    return calibrate_machine.run(calibrate_machine.TASK.job(settings, points=points))


@pytest.fixture(scope="module")
def machine() -> sim.Machine:
    # three knots from -500 to 0 and from 0 to 600; zero of Y lies between two of its four
    return sim.random_machine(np.random.default_rng(1), knots=(3, 4, 3))


@pytest.fixture(scope="module")
def result(machine: sim.Machine) -> Result:
    return calibrated(machine, 2, sim.THREE)


def checked(machine: sim.Machine, seed: int, n: int, tools: dict[str, tuple[float, float, float]] = sim.THREE) -> Table:
    """Where the true machine goes, in a frame of its own, with independent noise."""
    rng = np.random.default_rng(seed)
    position, which = rng.uniform(sim.LOW, sim.HIGH, (n, 3)), rng.integers(len(tools), size=n)
    at = sim.reached(machine, position, np.array(list(tools.values()))[which])
    seen = (at - HERE) @ TURN + rng.normal(size=(n, 3)) * SIGMA
    table = sim.point_table(position, seen, np.array(list(tools))[which])
    return replace(table, columns={**table.columns, "sigma": np.full(n, SIGMA)})


def by_differences(result: Result, machine: sim.Machine, check: Table) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Predicted places and their covariance (3n, 3n), with one table entry after the other stepped in the own model."""
    error, position = (
        result.tables["tables_entries"].texts("error"),
        result.tables["tables_entries"].numbers("position"),
    )
    square = {one.name: one.value for one in result.estimates}
    names = ("A0Z", "B0Z", "C0Y")
    tables = {name: np.nan_to_num(result.tables[f"tables/{name}"].numbers("value")) for name in sim.NAMES}
    own = replace(machine, tables=tables, squareness=tuple(square.get(name, 0.0) for name in names))
    vectors = np.array([sim.THREE[name] for name in check.texts("tool")])
    commanded = check.stacked("xyz")
    places = sim.reached(own, commanded, vectors)
    columns = []
    for name, at in zip(error, position, strict=True):
        if name in names:
            step = [1e-3 * (name == one) + value for one, value in zip(names, own.squareness, strict=True)]
            moved = replace(own, squareness=tuple(step))
        else:
            moved = replace(own, tables={**tables, name: tables[name] + 1e-3 * np.isclose(own.positions(name[2]), at)})
        columns.append((sim.displacements(moved, commanded, vectors) - (places - commanded - vectors)).ravel() / 1e-3)
    design = np.array(columns).T
    return places, design @ result.arrays["tables_covariance"] @ design.T


def fitted(points: np.ndarray, onto: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Points after the rotation and shift of least squares (Arun 1987)."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = v.T @ np.diag([1.0, 1.0, np.linalg.det(v.T @ u.T)]) @ u.T
    return a @ turn.T + onto.mean(axis=0)


def motions(places: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """How small shifts and turns move places, (3n, 6)."""
    columns = [np.tile(unit, len(places)) for unit in np.eye(3)]
    columns += [np.cross(unit, places - places.mean(axis=0)).ravel() for unit in np.eye(3)]
    return np.array(columns).T


@pytest.mark.parametrize("aligned", [False, True])
def test_figures_of_a_machine_are_those_of_plain_numpy(result: Result, machine: sim.Machine, aligned: bool) -> None:
    check = checked(machine, 3, 20)
    places, spread = by_differences(result, machine, check)
    measured = check.stacked(("mx", "my", "mz"))
    if aligned:
        measured = measured @ TURN.T + HERE
        shifted = dict(zip(("mx", "my", "mz"), measured.T, strict=True))
        check = replace(check, columns={**check.columns, **shifted})
    spread = spread + SIGMA**2 * np.eye(len(spread))
    if not aligned:
        measured = fitted(measured, places)
        moves = motions(places)
        left = np.eye(len(spread)) - moves @ np.linalg.pinv(moves)
        spread = left @ spread @ left.T
    found = verify(result, check, aligned)
    vectors = measured - places
    for i, one in enumerate(found.deviations):
        block = spread[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        en = np.sqrt(vectors[i] @ np.linalg.solve(block, vectors[i]) / chdtri(3, 0.04550026))
        assert one.vector == pytest.approx(vectors[i], abs=1e-8)
        assert one.value == pytest.approx(np.linalg.norm(vectors[i]), abs=1e-8)
        assert one.en == pytest.approx(en, rel=1e-3)
        assert one.expanded == pytest.approx(one.value / en, rel=1e-3)
    sizes = np.linalg.norm(vectors, axis=1)
    assert found.mean == pytest.approx(sizes.mean(), abs=1e-8)
    assert found.rms == pytest.approx(np.sqrt((sizes**2).mean()), abs=1e-8)
    assert found.largest == pytest.approx(sizes.max(), abs=1e-8)


def test_k_has_the_probability_of_two_standard_uncertainties() -> None:
    assert np.array(COVERAGE) == pytest.approx([np.sqrt(chdtri(dof, 0.04550026)) for dof in (1, 2, 3)], abs=1e-4)


@pytest.mark.parametrize(("dof", "components"), [(5, 1), (5, 3), (12, 2)])
def test_few_degrees_of_freedom_have_a_larger_k(dof: int, components: int) -> None:
    """Drawn: normal deviations over a standard deviation from `dof` residuals."""
    rng = np.random.default_rng([dof, components])
    found = np.linalg.norm(rng.normal(size=(200_000, components)), axis=1)
    found /= np.sqrt(rng.chisquare(dof, len(found)) / dof)
    assert np.mean(found <= factor(components, dof)) == pytest.approx(0.9545, abs=0.002)
    assert factor(components, np.inf) == pytest.approx(COVERAGE[components - 1])
    assert factor(components, 1e9) == pytest.approx(COVERAGE[components - 1], abs=1e-4)


def test_u_of_an_estimated_noise_has_the_t_factor(placed: Result) -> None:
    """t(95.45 %) of GUM table G.2: 2.65 for 5 degrees of freedom, 2.28 for 10; a check of its own counts as certain."""
    ends = {"from": np.array(["P0", "P1"]), "to": np.array(["P5", "P6"])}
    pairs = [distance(placed, a, b) for a, b in zip(*ends.values(), strict=True)]
    sigma = np.array([0.0, pairs[1].std])
    columns = {**ends, "length": np.array([one.value for one in pairs]), "sigma": sigma}
    check = Table(columns, {}, "c.csv", (2, 3))
    few = replace(placed, statistics={"noise_estimated": True, "dof": 5})
    known, found = verify(placed, check).deviations, verify(few, check).deviations
    assert found[0].expanded / known[0].expanded == pytest.approx(2.65 / 2, abs=0.003)
    # half of the variance is that of the result: 5 * 2^2 = 20 degrees of freedom, k 2.13
    assert found[1].k == pytest.approx(2.13, abs=0.005)


@pytest.mark.slow
def test_a_true_machine_is_inside_and_a_planted_wrong_point_is_found(machine: sim.Machine) -> None:
    share = []
    for seed in range(8):
        # with one tool some tables are open: the prediction for that tool holds all the same
        tools = sim.ONE if seed % 2 else sim.THREE
        result, check = calibrated(machine, 20 + seed, tools), checked(machine, 50 + seed, 100, tools)
        share.append(verify(result, check).inside)
    # 800 points, in eight groups that share a calibration
    assert np.mean(share) == pytest.approx(0.9545, abs=0.03)
    wrong = check.columns["my"].copy()
    wrong[17] += 0.02
    found = verify(result, replace(check, columns={**check.columns, "my": wrong}))
    worst = max(found.deviations, key=lambda one: one.en)
    assert (worst.name, worst.en > 2) == ("P17", True)
    assert worst.value == pytest.approx(0.02, abs=5 * SIGMA)
    assert sorted(one.en for one in found.deviations)[-2] < 1.6


@pytest.mark.parametrize("aligned", [False, True])
def test_points_without_the_vector_of_their_tool_are_said_to_be(
    result: Result, machine: sim.Machine, aligned: bool
) -> None:
    check = checked(machine, 5, 30)
    vectors = np.array([sim.THREE[name] for name in check.texts("tool")])
    seen = check.stacked(("mx", "my", "mz")) - (vectors @ TURN)
    if aligned:
        seen = seen @ TURN.T + HERE
    found = verify(result, with_measured(check, seen), aligned)
    assert "leave out the vector of the tool" in found.mistake
    assert not verify(result, check).mistake


def test_points_off_by_one_vector_are_said_to_be(result: Result, machine: sim.Machine) -> None:
    check = checked(machine, 5, 30)
    seen = check.stacked(("mx", "my", "mz")) @ TURN.T + HERE
    moved = verify(result, with_measured(check, seen + [0.0, 0.0, 12.7]), aligned=True)
    assert moved.mistake.startswith("all points are off by one vector, (")
    assert "12.7 mm long" in moved.mistake
    assert not verify(result, with_measured(check, seen), aligned=True).mistake
    far = seen.copy()
    far[3] += 12.7
    assert not verify(result, with_measured(check, far), aligned=True).mistake


def with_measured(check: Table, seen: np.ndarray) -> Table:  # type: ignore[type-arg]
    return replace(check, columns={**check.columns, **dict(zip(("mx", "my", "mz"), seen.T, strict=True))})


def test_rows_without_a_prediction_are_listed_together(result: Result, machine: sim.Machine) -> None:
    check = checked(machine, 4, 5)
    x, tool = check.columns["x"].copy(), check.columns["tool"].astype("U9")
    x[1], tool[3] = 700.0, "T7"
    with pytest.raises(InputError) as caught:
        verify(result, replace(check, columns={**check.columns, "x": x, "tool": tool}))
    text = str(caught.value)
    assert "points.csv:3: error: the commanded x 700 mm of point 'P1' is outside the calibrated axis" in text
    assert "points.csv:5: error: the result has no tool 'T7' (column 'tool')" in text
    none = {name: column for name, column in check.columns.items() if name != "tool"}
    with pytest.raises(InputError, match="several tools"):
        verify(result, replace(check, columns=none))
    two = {name: column[:2] for name, column in check.columns.items()}
    with pytest.raises(InputError, match="2 points cannot be laid"):
        verify(result, replace(check, columns=two))


def test_a_result_of_one_tool_predicts_no_other(machine: sim.Machine) -> None:
    """Points of T2 were held against the prediction for T1, as if they were of that tool."""
    known, check = calibrated(machine, 20, sim.ONE), checked(machine, 50, 20, sim.ONE)
    other = replace(check, columns={**check.columns, "tool": np.array(["T2"] * 20)})
    with pytest.raises(InputError, match="the result has no tool 'T2'"):
        verify(known, other)
    tools = known.tables["tools"]
    nameless = replace(tools, columns={**tools.columns, "tool": np.array([""])})
    unnamed = replace(known, tables={**known.tables, "tools": nameless})
    assert verify(unnamed, other).largest == verify(known, check).largest
    mixed = replace(check, columns={**check.columns, "tool": np.array(["T1", "T2"] * 10)})
    with pytest.raises(InputError, match="the points have 2 tools"):
        verify(unnamed, mixed)


def test_tools_whose_errors_are_open_are_refused(machine: sim.Machine, result: Result) -> None:
    tools = result.tables["tools"]
    closed = replace(tools, columns={**tools.columns, "predictable": np.array([True, False, True])})
    with pytest.raises(InputError, match="does not determine the errors of tool 'T2'"):
        verify(replace(result, tables={**result.tables, "tools": closed}), checked(machine, 5, 30))


def test_results_that_predict_nothing_are_refused(result: Result) -> None:
    with pytest.raises(InputError, match="align-part predicts neither"):
        columns_for(Result("align-part", "", (), np.zeros((0, 0)), {}), ["point"])
    with pytest.raises(InputError, match="no named points"):
        columns_for(result, ["from", "to", "length_mm", "sigma_mm"])


@pytest.fixture(scope="module")
def placed() -> Result:
    net = network(12, 5, seed=1)
    return multilaterate.run(multilaterate.TASK.job(of_lengths(), net.lengths(), net.point_table()))


def test_lengths_between_points_have_the_uncertainty_of_the_pair(placed: Result) -> None:
    pairs = [("P0", "P5"), ("P3", "P11"), ("P7", "P2")]
    off, sigma = np.array([2e-3, -1e-3, 0.0]), np.array([1e-3, 0.0, 4e-3])
    truth = [distance(placed, *pair) for pair in pairs]
    ends = {"from": np.array([a for a, _ in pairs]), "to": np.array([b for _, b in pairs])}
    check = Table(
        {**ends, "length": np.array([one.value for one in truth]) + off, "sigma": sigma}, {}, "c.csv", (2, 3, 4)
    )
    found = verify(placed, check)
    expanded = [2 * np.hypot(one.std, s) for one, s in zip(truth, sigma, strict=True)]
    assert [one.value for one in found.deviations] == pytest.approx(off, abs=1e-9)
    assert [one.expanded for one in found.deviations] == pytest.approx(expanded, rel=1e-6)
    assert [one.en for one in found.deviations] == pytest.approx(np.abs(off) / expanded, rel=1e-5, abs=1e-6)
    assert found.mean == pytest.approx(off.mean(), abs=1e-9)
    assert not found.mistake
    four = {"from": np.append(ends["from"], "P1"), "to": np.append(ends["to"], "P4")}
    read = np.array([*(one.value for one in truth), distance(placed, "P1", "P4").value]) + 12.7
    shifted = verify(placed, Table({**four, "length": read, "sigma": np.append(sigma, 1e-3)}))
    assert shifted.mistake.startswith("all lengths are off by 12.7 mm")
    named = replace(check, columns={**check.columns, "to": np.array(["P5", "P99", "P7"])})
    with pytest.raises(InputError, match=r"c.csv:3: error: the result has no point 'P99' \(column 'to'\)"):
        verify(placed, named)


def test_points_of_a_network_use_the_covariance_between_them(placed: Result) -> None:
    table, rng = placed.tables["points"], np.random.default_rng(8)
    rows = rng.permutation(len(table))[:9]
    places = table.stacked("xyz")[rows]
    measured = (places - HERE) @ TURN + rng.normal(size=places.shape) * SIGMA
    columns = {"point": table.columns["point"][rows], "sigma": np.full(len(rows), SIGMA)}
    found = verify(placed, Table(columns | dict(zip("xyz", measured.T, strict=True))))
    common, core = placed.arrays["points_common"][rows].reshape(27, -1), placed.arrays["points_core"]
    spread = common @ core @ common.T
    for i, row in enumerate(rows):
        spread[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = placed.arrays["points_covariance"][row]
    spread += SIGMA**2 * np.eye(27)
    moves = motions(places)
    left = np.eye(27) - moves @ np.linalg.pinv(moves)
    spread = left @ spread @ left.T
    vectors = fitted(measured, places) - places
    for i, one in enumerate(found.deviations):
        block = spread[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        en = np.sqrt(vectors[i] @ np.linalg.solve(block, vectors[i]) / chdtri(3, 0.04550026))
        assert one.en == pytest.approx(en, rel=1e-3)
        assert one.vector == pytest.approx(vectors[i], abs=1e-8)
