"""Machines with rotary axes: errors found again, what few balls leave open, effects, and jobs that are refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli.errors import InputError, UndeterminedError
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.result import Result
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine, solve
from metrocli.tasks.calibrate_machine.tables import Tables, tables_of
from metrocli.tasks.calibrate_machine.volume import predict

Array = sim.Array
TABLES = sim.KINDS["table-table"]


def solved(job: Path) -> AdjustedMachine:
    file = load(job)
    held = calibrate_machine.TASK.job(file.settings, effects=file.effects, **read_inputs(file))
    return solve(calibrate_machine.problem_of(held).with_effects(file.effects), False)


def result(job: Path) -> Result:
    file = load(job)
    return calibrate_machine.run(calibrate_machine.TASK.job(file.settings, effects=file.effects, **read_inputs(file)))


def off_in_volume(machine: sim.Machine, found: AdjustedMachine, tables: Tables, tool: str) -> float:
    """The largest error of the prediction at 40 places between the readings, less a motion of the workpiece."""
    rng = np.random.default_rng(9)
    poses = [machine.drawn_pose(rng) for _ in range(40)]
    nominal, errors = sim.errors_at(machine, poses, np.array(machine.kind.tools[tool]))
    axes = found.problem.machine.axes
    position = np.array([[pose[axis.letter] for pose in poses] for axis in axes])
    number = list(machine.kind.tools).index(tool)
    predicted = predict(found.problem.machine, tables.blocks, (tables.unknowns, tables.raw), position, number)[0]
    return float(np.abs(sim.without_motion(nominal, predicted.error.T - errors)).max())


@pytest.mark.parametrize(
    ("kind", "method"), [("table-table", "probing"), ("head-table", "lengths"), ("head-head", "standstill")]
)
def test_errors_are_found_again_without_noise(kind: str, method: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    machine = sim.drawn(sim.KINDS[kind], rng, linear=method != "probing")
    if method == "probing":
        job = sim.probed(tmp_path, machine, rng, 150, 0.0)
    else:
        stations = 5 if method == "lengths" else 0
        on = "bed" if kind == "head-head" else "workpiece"
        job = sim.tracked(tmp_path, machine, rng, 130 if stations else 260, (0.0, 0.0, 0.0), on, stations)
    found = solved(job)
    tables = tables_of(found.problem.machine, found.solution)
    for name, values in machine.tables.items():
        assert np.abs(tables.of(name)[1] - values).max() < (1e-6 if name[1] in "XYZ" else 1e-9)
    listed = {name for name, _ in tables.entries}
    for name, value in machine.places.items():
        assert name in listed
        assert tables.of(name)[1][0] == pytest.approx(value, abs=1e-6 if name[1] in "XYZ" else 1e-9)
    assert off_in_volume(machine, found, tables, "T1") < 1e-6


def test_what_the_result_has_of_rotary_axes(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    found = result(sim.probed(tmp_path, sim.drawn(TABLES, rng, linear=False), rng, 120, 5e-4))
    table = found.tables["tables/EAC"]
    assert table.units["position"] == "rad"
    assert len(table) == 9
    assert table.numbers("value")[0] == table.numbers("value")[-1]
    assert {"EX0C", "EY0C", "EA0C", "EB0C", "EY0A", "EZ0A", "EB0A", "EC0A"} == {one.name for one in found.estimates}
    assert found.tables["balls"].texts("ball") == ["K1", "K2", "K3"]
    assert found.tables["rotary_axes"].texts("axis") == ["A", "C"]
    assert found.statistics["sigma0"] == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("balls", "words"),
    [(1, "one ball does not determine EAC EBC ECC beside EXC EYC EZC and the places of C"),
     (2, "two balls do not determine the turn about their line")],
)  # fmt: skip
def test_too_few_balls_are_refused_and_enough_for_locations(balls: int, words: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    job = sim.probed(tmp_path, sim.drawn(TABLES, rng, linear=False), rng, 150, 5e-4, balls=balls)
    with pytest.raises(UndeterminedError, match=re.escape(words)):
        solved(job)
    job.write_text(job.read_text().replace("estimate: rotary", "estimate: locations"))
    assert not solved(job).identified.undetermined


def test_a_free_scale_needs_a_calibrated_distance(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    machine = sim.drawn(TABLES, rng, linear=False)
    machine.tables |= {name: 0 * values for name, values in machine.tables.items()}
    balls = np.array(TABLES.balls)
    job = sim.probed(tmp_path, machine, rng, 120, 5e-4, "[locations, EXX, EYY, EZZ]", true_balls=balls)
    with pytest.raises(UndeterminedError, match="one calibrated distance closes it"):
        solved(job)
    far = np.linalg.norm(balls[0] - balls[1])
    (tmp_path / "distances.csv").write_text(f"from,to,length_mm,sigma_mm\nK1,K2,{far:.6f},0.0001\n")
    job.write_text(job.read_text().replace("balls: balls.csv", "balls: balls.csv, distances: distances.csv"))
    assert solved(job).solution.misfit == pytest.approx(1.0, abs=0.2)


def test_one_tool_of_a_head_leaves_angles_open_and_its_prediction_stands(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    kind = sim.Kind(**{**vars(sim.KINDS["head-head"]), "tools": {"T1": (0.0, 0.0, -120.0)}})
    machine = sim.drawn(kind, rng)
    found = solved(sim.tracked(tmp_path, machine, rng, 400, (1e-4, 1e-4, 0.0), "bed"))
    assert {"EAA", "EBA", "ECA"} <= set(found.identified.undetermined)
    assert {"EXA", "EYA", "EZA"} <= set(found.identified.together)
    tables = tables_of(found.problem.machine, found.solution)
    assert off_in_volume(machine, found, tables, "T1") < 2e-3


def test_an_unknown_probe_shifts_all_pivots(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    machine = sim.drawn(TABLES, rng, linear=False)
    job = sim.probed(tmp_path, machine, rng, 150, 1e-4, tools={"T1": np.array([0.03, -0.01, -119.96])})
    job.write_text(job.read_text().replace("estimate:", "  tool_uncertainty: unknown\nestimate:"))
    found = solved(job)
    open_ones = {*found.identified.undetermined, *found.identified.together}
    assert open_ones == {"EX0C", "EY0C", "EY0A", "EZ0A"}
    assert found.solution.misfit == pytest.approx(1.0, abs=0.2)


def worm(letter: str, s: float, i: int) -> Array:
    return np.array([0, 0, 0, 0, 0, 3e-5 * np.sin(40 * s + 0.7), 0, 0, 0]) * (letter == "C")


def crash(letter: str, s: float, i: int) -> Array:
    return np.array([0, 0, 0, 0, 0, 0, 0, 4e-3, -3e-3]) * (letter == "A" and i >= 60)


def unbalance(letter: str, s: float, i: int) -> Array:
    return np.array([0, 0, 0, 0, 0, 0, 3e-3 * i / 120, -2e-3 * i / 120, 0]) * (letter == "C")


EFFECTS: list[tuple[Callable[[str, float, int], Array], str, dict[str, float]]] = [
    (worm, "worm-error, axis: c, periods: 40", {"amplitude": 3e-5, "phase": 0.7}),
    (crash, "axis-jump, axis: a, at: 952 s", {"dy": 4e-3, "dz": -3e-3}),
    (unbalance, "pivot-drift, axis: c", {"vx": 3e-3 / 120 / 16, "vy": -2e-3 / 120 / 16}),
]


@pytest.mark.parametrize(
    ("planted", "text", "truth"),
    [pytest.param(*one, marks=() if one[0] is crash else pytest.mark.slow) for one in EFFECTS],
    ids=[one[1].split(",")[0] for one in EFFECTS],
)
def test_an_effect_in_the_job_is_estimated(
    planted: Callable[[str, float, int], Array], text: str, truth: dict[str, float], tmp_path: Path
) -> None:
    """Planted into the joints of the simulation, which knows nothing of the program's links."""
    rng = np.random.default_rng(7)
    machine = sim.drawn(TABLES, rng, linear=False)
    machine.disturbed = planted
    job = sim.probed(tmp_path, machine, rng, 150, 1e-5)
    job.write_text(job.read_text() + f"effects: [{{name: {text}}}]\n")
    found = {one.name.rsplit(".", 1)[1]: one for one in result(job).estimates if "." in one.name}
    for name, value in truth.items():
        assert found[name].value == pytest.approx(value, abs=max(4 * found[name].std, 1e-3 * abs(value)))


BAD = {
    "no bed": ("wCAbXYZt", "wCAXYZt", "does not mark the bed with b"),
    "an axis twice": ("wCAbXYZt", "wCCAbXYZt", "each of X, Y, Z and at most two of A, B, C once"),
    "no place": (", at: [0.0 mm, 12.0 mm, -520.0 mm]", "", "at"),
    "more than a turn": ("[0 deg, 360 deg]", "[0 deg, 400 deg]", "one turn"),
    "no axis": ("wCAbXYZt", "wBAbXYZt", "no axis is given"),
}


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD)
def test_bad_machines_are_refused(old: str, new: str, words: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    job = sim.probed(tmp_path, sim.drawn(TABLES, rng), rng, 5, 5e-4)
    assert old in job.read_text()
    job.write_text(job.read_text().replace(old, new))
    with pytest.raises(InputError, match=re.escape(words)):
        load(job)


COLUMNS = {
    "no column": (lambda text: text.replace("c_deg", "q_deg"), "the column 'c_deg' is missing"),
    "an axis that the chain lacks": (lambda text: text.replace("tool", "b_deg").replace("T1", "0"), "has no B"),
    "outside the range": (
        lambda text: re.sub(r"^(K\d,.*?,.*?,.*?,)[^,]*", r"\g<1>99", text, count=1, flags=re.M),
        "range",
    ),
}


@pytest.mark.parametrize(("change", "words"), COLUMNS.values(), ids=COLUMNS)
def test_bad_columns_are_refused(change: Callable[[str], str], words: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    job = sim.probed(tmp_path, sim.drawn(TABLES, rng), rng, 5, 5e-4)
    file = tmp_path / "probing.csv"
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=re.escape(words)):
        solved(job)


def test_a_periodic_axis_takes_any_turn(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    job = sim.probed(tmp_path, sim.drawn(TABLES, rng, linear=False), rng, 120, 5e-4)
    first = solved(job).solution
    file = tmp_path / "probing.csv"
    head, *lines = file.read_text().splitlines()
    at = head.split(",").index("c_deg")
    turned = [line.split(",") for line in lines]
    for i, cells in enumerate(turned):
        cells[at] = f"{float(cells[at]) + 360 * (i % 3 - 1):.9f}"
    file.write_text("\n".join([head, *(",".join(cells) for cells in turned)]) + "\n")
    assert solved(job).solution.cost == pytest.approx(first.cost, rel=1e-6)


@pytest.mark.slow
def test_the_prediction_is_verified_by_points_on_the_workpiece(tmp_path: Path) -> None:
    """Points of another tool, in a frame of their own, with noise as stated."""
    from metrocli.formats import csv
    from metrocli.uncertainty.predicted import reached
    from metrocli.uncertainty.verification import COMMANDED

    rng = np.random.default_rng(11)
    machine = sim.drawn(sim.KINDS["head-table"], rng, linear=False)
    found = result(sim.probed(tmp_path, machine, rng, 200, 1e-4))
    poses = [machine.drawn_pose(rng) for _ in range(30)]
    cells = "\n".join(f"P{i},{sim.cells(pose)},0,0,0,T2" for i, pose in enumerate(poses))
    (tmp_path / "check.csv").write_text(f"point,{sim.header(machine)},mx_mm,my_mm,mz_mm,tool\n{cells}\n")
    places = reached(found, csv.read(tmp_path / "check.csv", COMMANDED))
    true = np.array([machine.tip(pose, np.array(machine.kind.tools["T2"])) for pose in poses])
    off = sim.without_motion(true, places.values - true)
    assert np.abs(off).max() < 2e-3
    std = np.sqrt(np.einsum("naa->na", places.covariance))
    assert 1e-5 < np.median(std) < 1e-3


def probings(folder: Path, seed: int = 12) -> tuple[Path, list[list[str]]]:
    """Return a job of three balls, and the cells of its readings with their head."""
    rng = np.random.default_rng(seed)
    job = sim.probed(folder, sim.drawn(TABLES, rng, linear=False), rng, 120, 5e-4)
    return job, [line.split(",") for line in (folder / "probing.csv").read_text().splitlines()]


def rewritten(folder: Path, rows: list[list[str]]) -> None:
    (folder / "probing.csv").write_text("\n".join(map(",".join, rows)) + "\n")


def test_a_ball_seen_once_counts_as_none_and_is_named(tmp_path: Path) -> None:
    job, rows = probings(tmp_path)
    last = [i for i, cells in enumerate(rows) if cells[0] == "K3"][1:]
    rewritten(tmp_path, [cells for i, cells in enumerate(rows) if i not in last])
    with pytest.raises(UndeterminedError, match="two balls do not determine the turn about their line"):
        solved(job)
    job.write_text(job.read_text().replace("estimate: rotary", "estimate: locations"))
    assert solved(job).problem.warnings == (
        "K3 has one reading: it gives the place of the ball, and nothing of the machine",
    )


def test_balls_of_other_names_are_named(tmp_path: Path) -> None:
    job, rows = probings(tmp_path)
    other = {"K1": "K2", "K2": "K1"}
    rewritten(tmp_path, [[other.get(cells[0], cells[0]), *cells[1:]] for cells in rows])
    with pytest.raises(InputError, match="K1 and K2 are exchanged"):
        solved(job)
    row = next(i for i, cells in enumerate(rows) if cells[0] == "K1" and i > 30)
    rewritten(tmp_path, [[other[cells[0]], *cells[1:]] if i == row else cells for i, cells in enumerate(rows)])
    with pytest.raises(InputError, match=rf"probing.csv:{row + 1}: error: the probe is at K1, not at K2"):
        solved(job)


def counting_backwards(tmp_path: Path) -> Path:
    """Return a job of lengths whose file has C with the other sense."""
    rng = np.random.default_rng(13)
    machine = sim.drawn(sim.KINDS["head-table"], rng)
    machine.tables = {name: 0 * values for name, values in machine.tables.items()}
    machine.places |= dict.fromkeys(("A0Z", "B0Z", "C0Y"), 0.0)
    job = sim.tracked(tmp_path, machine, rng, 40, (1e-4, 0.0, 0.0), stations=4)
    text = job.read_text().replace("estimate: all", "estimate: locations")
    assert "periodic: true, sense: 1" in text
    job.write_text(text.replace("periodic: true, sense: 1", "periodic: true, sense: -1"))
    return job


def test_lengths_that_nothing_fits_leave_the_settings_to_be_tried(tmp_path: Path) -> None:
    """A fault with a hint, such as a unit that fits, would end the search for a wrong sense."""
    with pytest.raises(InputError) as refused:
        solved(counting_backwards(tmp_path))
    assert {fault.hint for fault in refused.value.faults} == {None}


@pytest.mark.slow
def test_a_wrong_sense_is_named_by_lengths_too(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    ran = metrocli("calibrate-machine", counting_backwards(tmp_path))
    assert ran.code == 3
    # y with the other sign is as good where C alone turns
    assert "machine.axes.c.sense: error: C counts the other way" in ran.err and "y has the wrong sign" in ran.err
