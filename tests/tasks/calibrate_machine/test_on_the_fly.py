"""On-the-fly: without noise the truth, with noise honest, and breaks, rests and wrong files found and said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.arrays import Array
from metrocli.errors import InputError, UndeterminedError
from metrocli.instruments.machine import Axis, Machine
from metrocli.instruments.machine_path import Path
from metrocli.instruments.track_alignment import align
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise
from metrocli.tasks.calibrate_machine.settings import Settings

KNOTS = (5, 5, 5)
NOISE = MachineNoise(beam=1e-3, lateral=5e-3)


def job(**more: object) -> Settings:
    return sim.settings("on-the-fly", knots=KNOTS, noise=NOISE, **more)


@pytest.fixture(scope="module")
def vertices() -> Array:
    return sim.walls(np.random.default_rng(31), 31)


@pytest.fixture(scope="module")
def machine() -> sim.Machine:
    return sim.random_machine(np.random.default_rng(32), knots=KNOTS, size=0.06)


def changed(table: Table, values: Array) -> Table:
    """The table with other coordinates (n, 3), of as many rows."""
    return Table({**table.columns, **dict(zip("xyz", values.T, strict=True))}, table.units, table.file, table.lines)


def of_rows(table: Table, rows: Array) -> Table:
    return Table(
        {name: values[rows] for name, values in table.columns.items()},
        table.units,
        table.file,
        tuple(np.array(table.lines)[rows].tolist()),
    )


def test_without_noise_nothing_is_left(machine: sim.Machine, vertices: Array) -> None:
    """No floor of the closest point: errors along the path do not enter (paper: 0.95 um on the path, 0.87 on a grid)."""
    flight = sim.flight(machine, vertices, np.random.default_rng(33), noise=0.0)
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=flight.track))
    whole, left = sim.left_in_volume(result.tables["volume"], machine, sim.ONE["T1"])
    assert whole > 0.08
    assert left < 1e-6
    assert result.statistics["rms"]["mm"] < 1e-6


@pytest.mark.slow
def test_with_noise_the_prediction_is_right_and_its_uncertainty_honest(machine: sim.Machine, vertices: Array) -> None:
    scores, sigma0 = [], []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        flight = sim.flight(machine, vertices, rng, spacing=2.0)
        result = calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=flight.track))
        volume = result.tables["volume"]
        _, left = sim.left_in_volume(volume, machine, sim.ONE["T1"])
        assert left < 0.001
        sigma0.append(result.statistics["sigma0"])
        assert result.statistics["noise_in_cells"] == pytest.approx(1.0, abs=0.03)
        for name in ("EXX", "EYX", "ECX", "EYY", "EZY", "EAX", "EAY", "EZZ"):
            table = result.tables[f"tables/{name}"]
            known = table.numbers("std") > 1e-15
            scores.append(
                ((table.numbers("value") - machine.tables[name]) / np.where(known, table.numbers("std"), 1))[known]
            )
    z = np.concatenate(scores)
    assert 0.8 < np.sqrt((z**2).mean()) < 1.2
    assert 0.91 < (np.abs(z) < 1.96).mean() < 0.985
    assert np.mean(sigma0) == pytest.approx(1.0, abs=0.04)


def test_several_tools_determine_every_table(machine: sim.Machine, vertices: Array) -> None:
    rng = np.random.default_rng(34)
    flight = sim.flight(machine, vertices[:25], rng, tools=sim.THREE, noise=0.0, spacing=3.0)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(job(tools=sim.THREE), path=flight.path, track=flight.track)
    )
    assert result.statistics["undetermined"] == ""
    assert result.statistics["beam_breaks"] == 0, "the tool was changed, the beam did not break"
    for name in sim.NAMES:
        assert np.abs(result.tables[f"tables/{name}"].numbers("value") - machine.tables[name]).max() < 1e-6


def test_a_rest_in_the_middle_of_a_leg_has_no_weight(machine: sim.Machine, vertices: Array) -> None:
    """A feed hold: thousands of points at one place, each with the same error of the tracker."""
    rng = np.random.default_rng(35)
    flight = sim.flight(machine, vertices, rng)
    at = len(flight.track) // 2
    xyz = flight.track.stacked("xyz")
    held = np.concatenate(
        [xyz[:at], np.repeat(xyz[at : at + 1] + 0.02, 4000, axis=0) + rng.normal(0, 0.004, (4000, 3)), xyz[at:]]
    )
    track = Table(dict(zip("xyz", held.T, strict=True)), flight.track.units, "track.csv")
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=track))
    assert result.statistics["cut_standing"] >= 3990
    assert result.statistics["sigma0"] == pytest.approx(1.0, abs=0.1)


def test_a_beam_break_in_the_middle_is_found_cut_and_said(machine: sim.Machine, vertices: Array) -> None:
    rng = np.random.default_rng(36)
    flight = sim.flight(machine, vertices, rng)
    n = len(flight.track)
    rows = np.concatenate([np.arange(n // 2), np.arange(n // 2 + 1500, n)])
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(job(), path=flight.path, track=of_rows(flight.track, rows))
    )
    assert result.statistics["beam_breaks"] == 1
    assert any(line.startswith("the beam broke once, on leg") for line in result.warnings)
    _, left = sim.left_in_volume(result.tables["volume"], machine, sim.ONE["T1"])
    assert left < 0.0015
    assert result.statistics["sigma0"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_tracker_that_looks_elsewhere_takes_no_other_points_with_it(machine: sim.Machine, vertices: Array) -> None:
    """Wherever it looks for how long: what is measured before and after stays on its leg."""
    flight = sim.flight(machine, vertices, np.random.default_rng(38), spacing=4.0)
    lost = []
    for share, place in ((0.2, [0.0, 0.0, 300.0]), (0.55, [900.0, 0.0, 0.0]), (0.8, [-2000.0, -500.0, 100.0])):
        xyz = flight.track.stacked("xyz").copy()
        at = int(share * len(xyz))
        xyz[at : at + 50] = place
        result = calibrate_machine.run(
            calibrate_machine.TASK.job(job(), path=flight.path, track=changed(flight.track, xyz))
        )
        lost.append(result.statistics["cut_wild"] - 50)
        assert not any("legs without points" in line for line in result.warnings)
    assert lost == [0, 0, 0]


def test_a_break_of_most_of_a_leg_leaves_its_ends(machine: sim.Machine, vertices: Array) -> None:
    """The leap over the gap is not the speed that the rest is held against."""
    flight = sim.flight(machine, vertices, np.random.default_rng(39), spacing=2.0)
    start, end = vertices[11], vertices[12]
    share = (flight.commanded - start) @ (end - start) / ((end - start) @ (end - start))
    on = np.linalg.norm(flight.commanded - start - share[:, None] * (end - start), axis=1) < 1e-6
    track = of_rows(flight.track, np.flatnonzero(~(on & (share > 0.2) & (share < 0.8))))
    result = calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=track))
    assert result.statistics["beam_breaks"] == 1
    assert not any("legs without points" in line for line in result.warnings)
    assert "12" in result.tables["residuals"].texts("leg")


def test_points_off_the_path_while_the_beam_is_lost_are_cut(machine: sim.Machine, vertices: Array) -> None:
    """The tracker looks elsewhere, at its nest, and comes back."""
    rng = np.random.default_rng(37)
    flight = sim.flight(machine, vertices, rng)
    xyz = flight.track.stacked("xyz").copy()
    at = len(xyz) // 3
    xyz[at : at + 300] = [300.0, 100.0, -50.0]
    xyz[at + 2000] += 0.3
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(job(), path=flight.path, track=changed(flight.track, xyz))
    )
    assert result.statistics["cut_wild"] == 300
    assert any("300 points of the track are farther from the path" in line for line in result.warnings)
    assert result.statistics["cut_off_path"] >= 1
    _, left = sim.left_in_volume(result.tables["volume"], machine, sim.ONE["T1"])
    assert left < 0.0015


@pytest.mark.parametrize(
    ("factor", "message"), [(1e-3, "0.001 times as large"), (1e3, "1000 times as large"), (1 / 25.4, "0.03937 times")]
)
def test_a_wrong_unit_is_told(machine: sim.Machine, vertices: Array, factor: float, message: str) -> None:
    flight = sim.flight(machine, vertices, np.random.default_rng(38), spacing=4.0)
    track = changed(flight.track, flight.track.stacked("xyz") * factor)
    with pytest.raises(InputError, match=message) as told:
        calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=track))
    assert "is their unit right?" in str(told.value)


def test_a_mirrored_tracker_is_told(machine: sim.Machine, vertices: Array) -> None:
    flight = sim.flight(machine, vertices, np.random.default_rng(39), spacing=4.0)
    with pytest.raises(InputError, match="the track is a mirror image of the path"):
        calibrate_machine.run(
            calibrate_machine.TASK.job(
                job(), path=flight.path, track=changed(flight.track, flight.track.stacked("xyz") * [1, -1, 1])
            )
        )


def test_the_track_of_another_path_is_told(machine: sim.Machine, vertices: Array) -> None:
    flight = sim.flight(machine, vertices, np.random.default_rng(40), spacing=4.0)
    other = sim.flight(machine, sim.walls(np.random.default_rng(41), 31), np.random.default_rng(42), spacing=4.0)
    with pytest.raises(InputError, match="does not have the shape of the path"):
        calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=other.track))


def test_a_path_outside_the_axes_is_told_with_its_line(machine: sim.Machine, vertices: Array) -> None:
    flight = sim.flight(machine, vertices, np.random.default_rng(43), spacing=4.0)
    values = flight.path.stacked("xyz").copy()
    values[3, 1] = 261.0
    with pytest.raises(
        InputError, match=r"path.csv:5: error: y = 261 mm is outside the range of the axis, -260 to 260 mm"
    ):
        calibrate_machine.run(calibrate_machine.TASK.job(job(), path=changed(flight.path, values), track=flight.track))


def test_a_tool_that_is_not_in_the_list_is_told(machine: sim.Machine, vertices: Array) -> None:
    flight = sim.flight(machine, vertices[:12], np.random.default_rng(44), tools=sim.THREE, spacing=4.0)
    two = {name: sim.THREE[name] for name in ("T1", "T2")}
    with pytest.raises(InputError, match=r"tool 'T3' is not among the job's tools"):
        calibrate_machine.run(calibrate_machine.TASK.job(job(tools=two), path=flight.path, track=flight.track))


def test_a_path_that_does_not_say_which_of_the_tools_is_told(machine: sim.Machine, vertices: Array) -> None:
    flight = sim.flight(machine, vertices, np.random.default_rng(44), spacing=4.0)
    path = Table({axis: flight.path.columns[axis] for axis in "xyz"}, flight.path.units, "path.csv")
    with pytest.raises(InputError, match="several tools, but the file has no column 'tool'"):
        calibrate_machine.run(calibrate_machine.TASK.job(job(tools=sim.THREE), path=path, track=flight.track))


def test_a_tool_that_is_not_known_is_found(machine: sim.Machine, vertices: Array) -> None:
    """3 mm of doubt about the vector change the predicted error by 3 mm times angles."""
    flight = sim.flight(machine, vertices, np.random.default_rng(47), spacing=8.0)
    settings = job()
    wrong = {"T1": (1.5, -2.0, 121.0)}
    loose = replace(settings, machine=replace(settings.machine, tools=wrong, tool_uncertainty=3.0))
    result = calibrate_machine.run(calibrate_machine.TASK.job(loose, path=flight.path, track=flight.track))
    _, left = sim.left_in_volume(result.tables["volume"], machine, sim.ONE["T1"])
    assert left < 0.0015


@pytest.mark.slow
def test_a_tool_of_which_nothing_is_known_is_refused_with_a_hint(machine: sim.Machine, vertices: Array) -> None:
    """300 mm of doubt about the vector are beyond the digits."""
    flight = sim.flight(machine, vertices, np.random.default_rng(47), spacing=40.0)
    settings = job()
    with pytest.raises(UndeterminedError, match="give `tool_uncertainty` as a few mm"):
        vague = replace(settings.machine, tools={"T1": (1.5, -2.0, 121.0)}, tool_uncertainty=300.0)
        calibrate_machine.run(
            calibrate_machine.TASK.job(replace(settings, machine=vague), path=flight.path, track=flight.track)
        )


def test_no_warning_names_a_key_that_the_method_does_not_take(machine: sim.Machine, vertices: Array) -> None:
    """On the fly there is neither `outliers: remove` nor a noise to be found."""
    flight = sim.flight(machine, vertices, np.random.default_rng(46), spacing=4.0)
    noisy = replace(job(), noise=MachineNoise(beam=1e-4, lateral=1e-3))
    result = calibrate_machine.run(calibrate_machine.TASK.job(noisy, path=flight.path, track=flight.track))
    assert any(line.startswith("sigma0 = ") for line in result.warnings)
    assert not any("remove" in line or "estimated" in line for line in result.warnings)
    assert [key for key, _ in replace(job(), outliers="remove").faults()] == ["outliers"]
    assert not list(job().faults())


def test_a_leg_without_points_is_said(machine: sim.Machine, vertices: Array) -> None:
    flight = sim.flight(machine, vertices, np.random.default_rng(45))
    way = np.linalg.norm(flight.commanded - vertices[11], axis=1) < 1e-9
    other = np.linalg.norm(flight.commanded - vertices[12], axis=1) < 1e-9
    gone = np.arange(np.flatnonzero(way)[-1] - 30, np.flatnonzero(other)[0] + 30)
    keep = np.setdiff1d(np.arange(len(flight.track)), gone)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(job(), path=flight.path, track=of_rows(flight.track, keep))
    )
    assert any(line == "legs without points, of 30: 12" for line in result.warnings)


@pytest.mark.slow
def test_the_start_needs_no_hint_of_where_the_tracker_stands(vertices: Array) -> None:
    """Any turn, any place, and a closed path, whose start and end are one point."""
    closed = np.concatenate([vertices, vertices[:1]])
    path = Path.of(closed, np.zeros(len(closed), dtype=int))
    rng = np.random.default_rng(46)
    for _ in range(10):
        turn = sim.rotation(rng.normal(size=3) * 2)
        commanded = sim.travel(closed, 3.0, rng)
        found = align(((commanded - [2000.0, -3000.0, 500.0]) @ turn).T, None, path, np.zeros((1, 3)))
        assert found.miss < 2.0
        back = found.pose[:3] - [2000.0, -3000.0, 500.0]
        assert np.linalg.norm(back) < 10.0


def test_cells_end_where_an_axis_passes_a_knot() -> None:
    axes = [Axis(letter, np.linspace(sim.LOW[i], sim.HIGH[i], 5)) for i, letter in enumerate("XYZ")]
    model = Machine((0, 1, 2), (axes[0], axes[1], axes[2]))
    path = Path.of(np.array([[0.0, 0.0, 0.0], [600.0, 0.0, 0.0], [600.0, 260.0, -500.0]]), np.zeros(3, dtype=int))
    second = float(np.hypot(260, 500))
    expected = [0, 150, 300, 450, 600, *(600 + second * share for share in (0.25, 0.5, 0.75, 1.0))]
    assert np.allclose(path.cells(model), expected)


def test_more_points_make_the_result_more_certain_not_slower_than_linear(machine: sim.Machine, vertices: Array) -> None:
    """Ten times the points: a third of the uncertainty, and the solution itself costs the same."""
    few, many = (sim.flight(machine, vertices, np.random.default_rng(47), spacing=spacing) for spacing in (10.0, 1.0))
    results = [
        calibrate_machine.run(calibrate_machine.TASK.job(job(), path=flight.path, track=flight.track))
        for flight in (few, many)
    ]
    std = [np.median(result.tables["tables/EYX"].numbers("std")[1:-1]) for result in results]
    assert std[0] / std[1] == pytest.approx(np.sqrt(len(many.track) / len(few.track)), rel=0.1)
    condensed = [result.statistics["condensed_points"] for result in results]
    assert condensed[1] <= condensed[0] * 1.3


def test_weights_are_those_of_the_beam(machine: sim.Machine, vertices: Array) -> None:
    """With a beam ten times better than its sides the normalised residuals have unit size in both directions."""
    rng = np.random.default_rng(48)
    flight = sim.flight(machine, vertices, rng)
    settings = replace(job(), noise=MachineNoise(beam=1e-3, lateral=5e-3))
    result = calibrate_machine.run(calibrate_machine.TASK.job(settings, path=flight.path, track=flight.track))
    residuals = result.tables["residuals"]
    for which in "ab":
        w, r = residuals.numbers(f"normalised_{which}"), residuals.numbers(f"redundancy_{which}")
        assert np.sqrt((w[r > 0.1] ** 2).mean()) == pytest.approx(1.0, abs=0.08)
    assert residuals.numbers("sigma_a").max() / residuals.numbers("sigma_a").min() > 3
