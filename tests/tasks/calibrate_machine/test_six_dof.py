"""Lines of a laser with six degrees of freedom, and the figures of ISO 230-2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import machine as sim
from simulated.machine import line, line_table

from metrocli.errors import InputError, UndeterminedError
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.acceptance.positioning import LineUncertainty
from metrocli.tasks.calibrate_machine.iso230 import Run, at_targets
from metrocli.tasks.calibrate_machine.iso230 import positioning as positioning_of
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise
from metrocli.tasks.calibrate_machine.settings import Settings

KNOTS = (5, 6, 5)
KNOWN = LineUncertainty(0.0005)
SPAN = sim.HIGH - sim.LOW


def positioning(runs: list[Run]) -> tuple[Table | None, tuple[str, ...]]:
    return positioning_of(runs, KNOWN)


def job(**more: object) -> Settings:
    return sim.settings(
        "six-dof",
        tools={"": (0.0, 0.0, 0.0)},
        knots=KNOTS,
        noise=MachineNoise(displacement=5e-4, straightness=1e-3, angle=1e-6),
        **more,
    )


AXES, DIAGONALS = ("x", "y", "z"), ("xy", "yz", "xz")


@pytest.fixture(scope="module")
def machine() -> sim.Machine:
    return sim.random_machine(np.random.default_rng(51), knots=KNOTS, size=0.02)


def test_without_noise_misalignment_goes_and_the_machine_stays(machine: sim.Machine) -> None:
    rng = np.random.default_rng(52)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(
            job(), lines=line_table([line(machine, axis, rng, 0.0) for axis in (*AXES, *DIAGONALS)])
        )
    )
    assert result.statistics["undetermined"] == ""
    for name in sim.NAMES:
        angle = name[1] in "ABC"
        assert np.abs(result.tables[f"tables/{name}"].numbers("value") - machine.tables[name]).max() < (
            1e-12 if angle else 1e-9
        )
    values = np.array([estimate.value for estimate in result.estimates])
    assert np.abs(values - machine.squareness).max() < 1e-12
    assert result.tables["lines"].texts("line") == [f"L{i}" for i in range(6)]


def test_squareness_from_diagonals_alone_would_be_wrong(machine: sim.Machine) -> None:
    """What the plain formula of two diagonals takes for squareness holds yaw and straightness too."""
    ends = np.array([[0.0, -260.0, 0.0], [600.0, 260.0, 0.0], [600.0, -260.0, 0.0], [0.0, 260.0, 0.0]])
    reached = ends + sim.displacements(machine, ends, np.zeros(3))
    first, second = np.linalg.norm(reached[1] - reached[0]), np.linalg.norm(reached[3] - reached[2])
    plain = (second**2 - first**2) / (4 * SPAN[0] * SPAN[1])
    # the solution with all lines knows it to 1.5 urad
    assert abs(plain - machine.squareness[2]) > 5 * 1.5e-6
    square = sim.Machine(
        "XYZ", KNOTS, {name: 0 * values for name, values in machine.tables.items()}, machine.squareness
    )
    reached = ends + sim.displacements(square, ends, np.zeros(3))
    first, second = np.linalg.norm(reached[1] - reached[0]), np.linalg.norm(reached[3] - reached[2])
    assert (second**2 - first**2) / (4 * SPAN[0] * SPAN[1]) == pytest.approx(machine.squareness[2], rel=1e-3)


@pytest.mark.slow
def test_uncertainties_are_honest(machine: sim.Machine) -> None:
    scores, sigma0 = [], []
    for seed in range(5):
        rng = np.random.default_rng(200 + seed)
        result = calibrate_machine.run(
            calibrate_machine.TASK.job(
                job(), lines=line_table([line(machine, axis, rng) for axis in (*AXES, *DIAGONALS)])
            )
        )
        sigma0.append(result.statistics["sigma0"])
        for name in sim.NAMES:
            found = result.tables[f"tables/{name}"]
            std = found.numbers("std")
            scores.append((found.numbers("value") - machine.tables[name])[std > 1e-15] / std[std > 1e-15])
        scores.append(
            np.array([(e.value - true) / e.std for e, true in zip(result.estimates, machine.squareness, strict=True)])
        )
    z = np.concatenate(scores)
    assert 0.9 < np.sqrt((z**2).mean()) < 1.1
    assert 0.93 < (np.abs(z) < 1.96).mean() < 0.97
    assert np.mean(sigma0) == pytest.approx(1.0, abs=0.02)


def test_lines_may_stand_elsewhere(machine: sim.Machine) -> None:
    """The columns x, y, z say where the other axes are; the tables are the same."""
    rng = np.random.default_rng(53)
    lines = [
        line(machine, "x", rng, 0.0, y=100.0, z=-200.0),
        line(machine, "y", rng, 0.0, x=300.0),
        line(machine, "z", rng, 0.0),
    ]
    lines += [line(machine, axis, rng, 0.0) for axis in DIAGONALS]
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=line_table(lines, ("x", "y", "z"))))
    assert np.abs(result.tables["tables/EYX"].numbers("value") - machine.tables["EYX"]).max() < 1e-9
    without = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=line_table(lines)))
    assert np.abs(without.tables["tables/EYX"].numbers("value") - machine.tables["EYX"]).max() > 1e-4


def test_without_diagonals_squareness_is_not_determined(machine: sim.Machine) -> None:
    rng = np.random.default_rng(54)
    lines = line_table([line(machine, axis, rng) for axis in AXES])
    with pytest.raises(UndeterminedError, match="does not determine 3 combinations of errors") as told:
        calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=lines))
    assert all(name in str(told.value) for name in ("A0Z", "B0Z", "C0Y"))
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(estimate=sim.NAMES), lines=lines))
    assert np.abs(result.tables["tables/EAX"].numbers("value") - machine.tables["EAX"]).max() < 5e-6


def test_one_missing_axis_is_told(machine: sim.Machine) -> None:
    rng = np.random.default_rng(55)
    with pytest.raises(UndeterminedError, match="no reading is near 4 of the 5 knots of Z"):
        calibrate_machine.run(
            calibrate_machine.TASK.job(job(), lines=line_table([line(machine, axis, rng) for axis in ("x", "y", "xy")]))
        )


def test_a_file_without_positions_is_told(machine: sim.Machine) -> None:
    lines = line_table([line(machine, axis, np.random.default_rng(56)) for axis in AXES])
    columns = {name: values for name, values in lines.columns.items() if name != "position"}
    with pytest.raises(InputError, match="the column 'position_mm' is missing"):
        calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=replace(lines, columns=columns)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: {"axis": np.where(np.arange(len(t)) == 3, "u", t.columns["axis"])},
            "lines.csv:5: error: 'u' is not a direction of a line",
        ),
        (
            lambda t: {"axis": np.where(np.arange(len(t)) == 3, "y", t.columns["axis"])},
            "line 'L0' has rows along x and y",
        ),
        (
            lambda t: {"line": np.where(np.arange(len(t)) == 3, "alone", t.columns["line"])},
            "line 'alone' has fewer than 3 positions",
        ),
        (
            lambda t: {"position": np.where(np.arange(len(t)) == 3, 601.0, t.columns["position"])},
            "lines.csv:5: error: x = 601 mm is outside",
        ),
    ],
)
def test_wrong_rows_are_told(machine: sim.Machine, change, message: str) -> None:  # type: ignore[no-untyped-def]
    whole = line_table([line(machine, axis, np.random.default_rng(56)) for axis in AXES])
    bad = Table({**whole.columns, **change(whole)}, whole.units, whole.file, whole.lines)
    with pytest.raises(InputError) as told:
        calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=bad))
    assert message in str(told.value)


def test_one_run_each_way_has_no_repeatability() -> None:
    runs = [
        Run("X", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0])),
        Run("X", np.array([2.0, 1.0, 0.0]), np.array([5.0, 2.0, 1.0])),
    ]
    found, warnings = positioning(runs)
    assert found is not None
    assert warnings == (
        "axis X, at rest: 1 run up and 1 down; ISO 230-2:2014 asks for five in each direction",
        "axis X, at rest: 3 targets over 2 mm; ISO 230-2:2014 asks for five per metre, and at least five",
    )
    assert found.texts("axis") == ["X"]
    assert found.numbers("B")[0] == 2.0 and found.numbers("E")[0] == 5.0 and found.numbers("M")[0] == 3.5
    assert np.isnan(found.numbers("R")[0]) and np.isnan(found.numbers("A")[0])
    assert positioning(runs[:1]) == (None, ())
    other, warnings = positioning([runs[0], Run("X", np.array([2.5, 1.1, 0.0]), np.zeros(3))])
    assert other is None
    assert (
        len(warnings) == 1 and "no figures of ISO 230-2, since its 2 runs have no two targets in common" in warnings[0]
    )


def test_backlash_shows_in_the_figures(machine: sim.Machine) -> None:
    rng = np.random.default_rng(57)
    up, down = line(machine, "x", rng, 0.1), line(machine, "x", rng, 0.1)
    down = {name: values[::-1] for name, values in down.items()}
    down["ex"] = down["ex"] - down["ex"][-1] + up["ex"][0] - 0.004
    both = {name: np.concatenate([up[name], down[name]]) for name in up}
    lines = [both, *(line(machine, axis, rng) for axis in (*AXES[1:], *DIAGONALS))]
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=line_table(lines)))
    found = result.tables["positioning"]
    assert found.texts("axis") == ["X"]
    assert found.numbers("B")[0] == pytest.approx(0.004, abs=0.0005)
    # as two lines each has a zero of its own, and the reversal is lost in them
    lines = [up, down, *(line(machine, axis, rng) for axis in (*AXES[1:], *DIAGONALS))]
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=line_table(lines)))
    assert "positioning" not in result.tables
    assert any("axis X: lines 'L0', 'L1' have a zero of their own" in line for line in result.warnings)


def test_runs_with_zeros_of_their_own_are_not_pooled() -> None:
    """Ten lines whose zeros scatter by 30 um: pooled, they would give an accuracy A of more than 100 um."""
    rng = np.random.default_rng(230)
    targets = np.arange(0.0, 501.0, 50.0)
    deviation = 0.01 * np.sin(targets / 80) + 0.001 * rng.normal(size=(10, len(targets)))
    zero = 0.03 * rng.normal(size=10)
    up = [n % 2 == 0 for n in range(10)]

    def runs(lines: list[str], zeros: np.ndarray) -> list[Run]:  # type: ignore[type-arg]
        made = zip(up, deviation + zeros[:, None], lines, strict=True)
        return [Run("X", *((targets, one) if to else (targets[::-1], one[::-1])), "", name) for to, one, name in made]

    one_line, none = positioning(runs(["L1"] * 10, np.zeros(10)))
    assert one_line is not None and none == ()
    means = np.stack([deviation[::2].mean(axis=0), deviation[1::2].mean(axis=0)])
    spread = np.stack([deviation[::2].std(axis=0, ddof=1), deviation[1::2].std(axis=0, ddof=1)])
    assert one_line.numbers("A")[0] == pytest.approx((means + 2 * spread).max() - (means - 2 * spread).min())
    figures_of_ten, warnings = positioning(runs([f"L{n}" for n in range(10)], zero))
    assert figures_of_ten is None
    assert len(warnings) == 1 and "do not pool their runs" in warnings[0]


def test_a_run_without_a_target_is_left_out_and_named() -> None:
    targets = np.arange(0.0, 401.0, 100.0)
    runs = [Run("X", targets[:: 1 - 2 * (n % 2)], np.full(5, 0.001 * n), "", "L1") for n in range(10)]
    runs[4] = Run("X", np.delete(targets, 2), np.full(4, 0.004), "", "L1")
    found, warnings = positioning(runs)
    assert found is not None and (found.numbers("runs_up")[0], found.numbers("runs_down")[0]) == (4, 5)
    assert warnings == (
        "axis X, line 'L1': run 5 lacks the target 200 mm; the figures of ISO 230-2 leave it out",
        "axis X, line 'L1': 4 runs up and 5 down; ISO 230-2:2014 asks for five in each direction",
    )


def drawn_runs(rng: np.random.Generator, targets: np.ndarray) -> list[Run]:  # type: ignore[type-arg]
    """Ten runs to and fro whose deviations scatter by 1 um."""
    deviation = 0.01 * np.sin(targets / 80) + 0.001 * rng.normal(size=(10, len(targets)))
    ways = [slice(None, None, 1 - 2 * (n % 2)) for n in range(10)]
    return [Run("X", targets[way], one[way], "", "L1") for way, one in zip(ways, deviation, strict=True)]


def test_a_target_of_one_run_does_not_cost_the_others() -> None:
    """One reading at a place of its own, in one of ten runs: the figures are those of the targets of all."""
    targets = np.arange(0.0, 401.0, 50.0)
    runs = drawn_runs(np.random.default_rng(1), targets)
    whole, none = positioning(runs)
    runs[3] = Run("X", np.insert(runs[3].targets, 2, 312.0), np.insert(runs[3].deviation, 2, 0.5), "", "L1")
    found, warnings = positioning(runs)
    assert whole is not None and found is not None and none == ()
    assert all(found.numbers(name) == pytest.approx(whole.numbers(name)) for name in ("A", "R", "E", "B_mean", "U_A"))
    assert warnings == (
        "axis X, line 'L1': at most half of the runs in one direction have the target at 312 mm; "
        "the figures of ISO 230-2 leave it out",
    )


def test_a_turn_that_is_read_once_leaves_the_targets_between_the_turns() -> None:
    targets = np.arange(0.0, 401.0, 50.0)
    runs = drawn_runs(np.random.default_rng(2), targets)
    once = [runs[0], *(Run("X", run.targets[1:], run.deviation[1:], "", "L1") for run in runs[1:])]
    found, warnings = positioning(once)
    inner = [Run("X", run.targets[1:-1], run.deviation[1:-1], "", "L1") for run in runs]
    expected, _ = positioning(inner)
    assert found is not None and expected is not None
    assert (found.numbers("runs_up")[0], found.numbers("runs_down")[0]) == (5, 5)
    assert found.numbers("A") == pytest.approx(expected.numbers("A"))
    assert len(warnings) == 1 and "the target at 0 mm and 400 mm" in warnings[0]


def test_runs_in_one_direction_have_the_figures_of_that_direction() -> None:
    targets = np.arange(0.0, 401.0, 50.0)
    up = drawn_runs(np.random.default_rng(3), targets)[::2]
    found, warnings = positioning(up)
    assert found is not None
    deviation = np.array([run.deviation for run in up])
    mean, s = deviation.mean(axis=0), deviation.std(axis=0, ddof=1)
    assert found.numbers("A_up")[0] == pytest.approx((mean + 2 * s).max() - (mean - 2 * s).min())
    assert found.numbers("R_up")[0] == pytest.approx(4 * s.max()) and found.numbers("U_R_up")[0] > 0
    assert found.numbers("E_up")[0] == pytest.approx(np.ptp(mean))
    for name in ("A", "A_down", "R", "R_down", "B", "B_mean", "E", "E_down", "M", "U_E", "U_M", "U_E_down"):
        assert np.isnan(found.numbers(name)[0])
    assert warnings == ("axis X, line 'L1': 5 runs up and 0 down; ISO 230-2:2014 asks for five in each direction",)
    table = at_targets(up)
    assert table is not None and np.isnan(table.numbers("down")).all() and table.numbers("up") == pytest.approx(mean)


def test_rows_in_the_order_of_places_have_no_figures_and_a_reason(machine: sim.Machine) -> None:
    """A file that was sorted by position says nothing of directions."""
    rng = np.random.default_rng(61)
    lines = [line(machine, axis, rng, 0.1) for axis in (*AXES, *DIAGONALS)]
    many = {name: np.repeat(values, 4) for name, values in lines[0].items()}
    many["ex"] = many["ex"] + 0.001 * rng.normal(size=len(many["ex"]))
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=line_table([many, *lines[1:]])))
    assert "positioning" not in result.tables
    assert any("no figures of ISO 230-2" in warning and "order of travel" in warning for warning in result.warnings)


def with_width(one: dict[str, sim.Array], width: float) -> dict[str, sim.Array]:
    """A line there and back under one alignment, with a reversal error."""
    there, back = dict(one), {name: values[::-1] for name, values in one.items()}
    there["ex"], back["ex"] = there["ex"] + width / 2, back["ex"] - width / 2
    return {name: np.concatenate([there[name], back[name]]) for name in one}


def test_a_line_may_go_to_and_fro(machine: sim.Machine) -> None:
    """The runs of a laser that is set up once: their figures of ISO 230-2."""
    rng = np.random.default_rng(58)
    lines = [line(machine, axis, rng) for axis in (*AXES, *DIAGONALS)]
    table = line_table([with_width(lines[0], 0.004), *lines[1:]])
    found = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=table)).tables["positioning"]
    assert found.texts("axis") == ["X"] and found.texts("at") == ["Y = 0 mm, Z = 0 mm"]
    assert (found.numbers("runs_up")[0], found.numbers("runs_down")[0]) == (1, 1)
    assert found.numbers("B")[0] == pytest.approx(0.004, abs=1e-9)


def test_runs_in_different_places_are_not_mixed() -> None:
    """Pitch and yaw make positioning another one elsewhere: each place has its own figures."""
    targets = np.array([0.0, 1.0, 2.0])
    runs = [
        Run("X", targets, np.zeros(3), "Y = 0 mm, Z = 0 mm"),
        Run("X", targets[::-1], np.full(3, 1.0), "Y = 0 mm, Z = 0 mm"),
        Run("X", targets, np.full(3, 50.0), "Y = 100 mm, Z = 0 mm"),
    ]
    found, _ = positioning(runs)
    assert found is not None and found.texts("at") == ["Y = 0 mm, Z = 0 mm"]
    assert found.numbers("B").tolist() == [1.0] and found.numbers("E").tolist() == [1.0]
    both, _ = positioning([*runs, Run("X", targets[::-1], np.full(3, 47.0), "Y = 100 mm, Z = 0 mm")])
    assert both is not None and both.numbers("B").tolist() == [1.0, 3.0]


def test_the_one_tool_may_have_a_name(machine: sim.Machine) -> None:
    rng = np.random.default_rng(59)
    lines = line_table([line(machine, axis, rng) for axis in (*AXES, *DIAGONALS)])
    named = sim.settings("six-dof", tools={"T1": (0.0, 0.0, 0.0)}, knots=KNOTS, noise=job().noise)
    result = calibrate_machine.run(calibrate_machine.TASK.job(named, lines=lines))
    assert result.tables["tools"].texts("tool") == ["T1"]


def test_a_wrong_reading_is_named_with_its_place(machine: sim.Machine) -> None:
    rng = np.random.default_rng(60)
    lines = line_table([line(machine, axis, rng) for axis in (*AXES, *DIAGONALS)])
    lines.columns["ex"][3] += 0.02
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=lines))
    assert result.tables["suspects"].texts("line")[0] == "L0 at 75 mm"
    assert any("line L0 at 75 mm (w = " in warning for warning in result.warnings)


def test_deviations_at_targets_by_hand() -> None:
    """Two runs up and one down: means and standard deviations at each target, in ascending order."""
    targets = np.array([0.0, 10.0])
    runs = [
        Run("Y", targets, np.array([0.001, 0.004]), "X = 5 mm, Z = 0 mm", "L"),
        Run("Y", targets[::-1], np.array([0.009, 0.002]), "X = 5 mm, Z = 0 mm", "L"),
        Run("Y", targets, np.array([0.003, 0.004]), "X = 5 mm, Z = 0 mm", "L"),
    ]
    found = at_targets(runs)
    assert found is not None and found.texts("at") == ["X = 5 mm, Z = 0 mm"] * 2
    assert found.numbers("up") == pytest.approx([0.002, 0.004]) and found.numbers("down") == pytest.approx(
        [0.002, 0.009]
    )
    assert found.numbers("s_up") == pytest.approx([0.001 * np.sqrt(2), 0.0]) and np.isnan(found.numbers("s_down")).all()
    assert at_targets(runs[:1]) is None


def test_a_channel_of_zeros_was_not_measured(machine: sim.Machine) -> None:
    """The roll of lines along x, which a laser and a level do not read; a plan of such lines stays possible."""
    rng = np.random.default_rng(61)
    table = line_table([line(machine, axis, rng) for axis in (*AXES, *DIAGONALS)])
    roll = np.where(np.array(table.texts("axis")) == "x", 0.0, table.numbers("ea"))
    table = replace(table, columns={**table.columns, "ea": roll})
    with pytest.raises(InputError) as refused:
        calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=table))
    (fault,) = refused.value.faults
    assert "'ea' is 0 in all rows of lines along x:" in fault.message and "all six channels" in fault.hint
    assert calibrate_machine.plan(calibrate_machine.TASK.job(job(), lines=table)).files["lines.nc"]


def test_zeros_beside_the_displacement_are_to_be_left_empty(machine: sim.Machine) -> None:
    rng = np.random.default_rng(62)
    table = line_table([line(machine, axis, rng) for axis in AXES])
    axis = np.array(table.texts("axis"))
    for channel in ("ex", "ey", "ez", "ea", "eb", "ec"):
        values = np.where(axis == channel[1], table.numbers(channel), 0.0)
        table = replace(table, columns={**table.columns, channel: values})
    with pytest.raises(InputError) as refused:
        calibrate_machine.run(calibrate_machine.TASK.job(job(), lines=table))
    assert [fault.hint for fault in refused.value.faults] == [
        *(f"leave '{channel}' empty there" for channel in ("ex", "ey", "ez")),
        *3 * ["leave the column out"],
    ]
    for channel in ("ex", "ey", "ez", "ea", "eb", "ec"):
        empty = np.where(axis == channel[1], table.numbers(channel), np.nan)
        table = replace(table, columns={**table.columns, channel: empty})
    settings = replace(job(), estimate=("EXX", "EYY", "EZZ"))
    assert "tables/EXX" in calibrate_machine.run(calibrate_machine.TASK.job(settings, lines=table)).tables
