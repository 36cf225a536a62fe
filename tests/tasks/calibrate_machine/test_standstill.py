"""Standstill: exact without noise, honest with it, and what is not as it should be is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.errors import InputError, UndeterminedError
from metrocli.instruments.machine import SQUARENESS_NAMES
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine

Metrocli = Callable[..., Any]


def scores(result, machine: sim.Machine) -> np.ndarray:  # type: ignore[no-untyped-def, type-arg]
    """Deviations of all table entries and squareness from the truth in standard uncertainties."""
    found = []
    for name in sim.NAMES:
        table = result.tables[f"tables/{name}"]
        std, off = table.numbers("std"), table.numbers("value") - machine.tables[name]
        known = std > 1e-15
        assert np.abs(off[~known]).max(initial=0.0) < 1e-15
        found.append(off[known] / std[known])
    for estimate in result.estimates:
        if estimate.name in SQUARENESS_NAMES:
            found.append(np.array([(estimate.value - sim.truth_of(machine, estimate.name)[0]) / estimate.std]))
    return np.concatenate(found)


@pytest.mark.alike
@pytest.mark.parametrize("order", ["XYZ", "YXZ", "ZXY"])
@pytest.mark.parametrize("knots", [(5, 5, 5), (7, 6, 4)], ids=["zero on a knot", "zero between knots"])
def test_without_noise_the_truth_comes_back(order: str, knots: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(11)
    machine = sim.random_machine(rng, order, knots)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(
            sim.settings(tools=sim.THREE, knots=knots, chain=order),
            points=sim.points(machine, rng, 250, sim.THREE, noise=0.0),
        )
    )
    for name in sim.NAMES:
        angle = name[1] in "ABC"
        assert np.abs(result.tables[f"tables/{name}"].numbers("value") - machine.tables[name]).max() < (
            1e-10 if angle else 1e-8
        )
    values = {estimate.name: estimate.value for estimate in result.estimates}
    assert np.abs(np.array([values[name] for name in SQUARENESS_NAMES]) - machine.squareness).max() < 1e-10


@pytest.mark.slow
def test_uncertainties_are_honest() -> None:
    """Over 6 measurements, each of its own machine: 95 % intervals hold the truth, and none is far off."""
    inside, squares, chi = [], [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        machine = sim.random_machine(rng, knots=(4, 5, 4))
        result = calibrate_machine.run(
            calibrate_machine.TASK.job(
                sim.settings(tools=sim.THREE, knots=(4, 5, 4)), points=sim.points(machine, rng, 150, sim.THREE)
            )
        )
        z = scores(result, machine)
        inside.append((np.abs(z) < 1.96).mean())
        squares.append((z**2).mean())
        chi.append(result.statistics["sigma0"])
    # entries of one measurement hang together: their share inside scatters by some per cent
    assert 0.92 < np.mean(inside) < 0.975
    assert 0.85 < np.mean(squares) < 1.15
    assert np.mean(chi) == pytest.approx(1.0, abs=0.02)


def test_squareness_between_least_squares_lines() -> None:
    """The reference lines differ from the end-point lines by the slopes of the straightness tables."""
    rng = np.random.default_rng(12)
    machine = sim.random_machine(rng)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(
            sim.settings(tools=sim.THREE), points=sim.points(machine, rng, 250, sim.THREE, noise=0.0)
        )
    )
    slope = {
        name: np.polyfit(machine.positions(name[2]), machine.tables[name], 1)[0]
        for name in ("EYX", "EZX", "EXY", "EZY", "EXZ", "EYZ")
    }
    a, b, c = machine.squareness
    # directions of the axes' lines as small rotations: X turns by EYX about Z, Y by -EXY, and so on
    expected = {
        "C0Y": c - slope["EXY"] - slope["EYX"],
        "B0Z": b + slope["EXZ"] + slope["EZX"],
        "A0Z": a - slope["EYZ"] - slope["EZY"],
    }
    table = result.tables["squareness"]
    for name, value in zip(table.texts("error"), table.numbers("least_squares"), strict=True):
        assert value == pytest.approx(expected[name], abs=1e-10)


def test_a_wrong_point_is_named_and_left_out_on_request() -> None:
    rng = np.random.default_rng(13)
    machine = sim.random_machine(rng)
    table = sim.points(machine, rng, 200, sim.THREE)
    moved = table.numbers("my").copy()
    moved[[20, 77]] += [0.05, -0.2]
    bad = replace(table, columns={**table.columns, "my": moved})
    result = calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(tools=sim.THREE), points=bad))
    assert result.tables["suspects"].texts("point") == ["P77", "P20"]
    assert any("2 readings exceed" in line for line in result.warnings)
    removed = calibrate_machine.run(
        calibrate_machine.TASK.job(sim.settings(tools=sim.THREE, outliers="remove"), points=bad)
    )
    assert set(removed.tables["rejected"].texts("point")) == {"P20", "P77"}
    assert removed.statistics["sigma0"] == pytest.approx(1.0, abs=0.1)
    assert np.abs(scores(removed, machine)).max() < 4.5


def test_tool_vectors_can_be_uncertain() -> None:
    """Vectors off by 50 um, said to be known to 50 um, are found again; taken as exact they spoil the fit."""
    rng = np.random.default_rng(14)
    machine = sim.random_machine(rng)
    true = {name: tuple(np.array(vector) + rng.normal(0, 0.05, 3)) for name, vector in sim.THREE.items()}
    table = sim.points(machine, rng, 300, true)
    exact = calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(tools=sim.THREE), points=table))
    assert exact.statistics["sigma0"] > 2
    found = calibrate_machine.run(
        calibrate_machine.TASK.job(sim.settings(tools=sim.THREE, tool_uncertainty=0.05), points=table)
    )
    assert found.statistics["sigma0"] == pytest.approx(1.0, abs=0.1)
    values = {estimate.name: estimate for estimate in found.estimates}
    for name, vector in true.items():
        for axis, value in zip("xyz", vector, strict=True):
            estimate = values[f"{name}.{axis}"]
            assert abs(estimate.value - value) < 4 * estimate.std
            assert estimate.std <= 0.0501
    # differences between tools are seen by the tracker
    covariance, names = found.covariance, [estimate.name for estimate in found.estimates]
    i, k = names.index("T1.x"), names.index("T2.x")
    assert np.sqrt(covariance[i, i] + covariance[k, k] - 2 * covariance[i, k]) < 0.003


def test_errors_that_are_not_estimated_are_zero_and_have_no_table() -> None:
    rng = np.random.default_rng(15)
    whole = sim.random_machine(rng)
    flat = {name: table * (name[1] not in "ABC") for name, table in whole.tables.items()}
    machine = sim.Machine("XYZ", (5, 5, 5), flat, whole.squareness)
    names = (*(name for name in sim.NAMES if name[1] not in "ABC"), "C0Y", "B0Z", "A0Z")
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(sim.settings(estimate=names), points=sim.points(machine, rng, 100, noise=0.0))
    )
    assert "tables/EAX" not in result.tables
    status = dict(zip(result.tables["errors"].texts("error"), result.tables["errors"].texts("status"), strict=True))
    assert status["EAX"] == "not estimated" and status["EXX"] == status["C0Y"] == "determined"
    assert np.abs(result.tables["tables/EXX"].numbers("value") - flat["EXX"]).max() < 1e-8


def test_two_knots_have_no_straightness() -> None:
    """Both are zero, the ends of its line: a job that asks for no more has nothing to find."""
    rng = np.random.default_rng(15)
    points = sim.points(sim.random_machine(rng), rng, 100)
    with pytest.raises(InputError, match="there is nothing to estimate: EYX EZX with two knots is zero"):
        calibrate_machine.run(
            calibrate_machine.TASK.job(sim.settings(knots=(2, 2, 2), estimate=("EYX", "EZX")), points=points)
        )


def test_a_knot_that_no_point_supports_is_named() -> None:
    rng = np.random.default_rng(16)
    machine = sim.random_machine(rng)
    table = sim.points(machine, rng, 300)
    keep = table.numbers("y") < 100
    short = Table({name: values[keep] for name, values in table.columns.items()}, table.units, table.file, table.lines)
    with pytest.raises(
        UndeterminedError, match=r"no reading is near 1 of the 5 knots of Y \(at 260 mm\): give y fewer knots"
    ):
        calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(), points=short))


def test_too_few_points_are_refused_with_the_combinations() -> None:
    rng = np.random.default_rng(17)
    machine = sim.random_machine(rng)
    with pytest.raises(UndeterminedError, match="of errors that move"):
        calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(), points=sim.points(machine, rng, 25)))


def test_the_predicted_diagonals_are_those_of_the_machine() -> None:
    rng = np.random.default_rng(18)
    machine = sim.random_machine(rng)
    result = calibrate_machine.run(
        calibrate_machine.TASK.job(sim.settings(tools=sim.THREE), points=sim.points(machine, rng, 300, sim.THREE))
    )
    table = result.tables["diagonals"]
    signs = {"PPP": (1, 1, 1), "NPP": (-1, 1, 1), "PNP": (1, -1, 1), "NNP": (-1, -1, 1)}
    deviations = []
    for name, sign in signs.items():
        rows = np.array(table.texts("diagonal")) == name
        start, end = np.where(np.array(sign) > 0, sim.LOW, sim.HIGH), np.where(np.array(sign) > 0, sim.HIGH, sim.LOW)
        length = np.linalg.norm(end - start)
        position = table.numbers("position")[rows]
        assert position[-1] == pytest.approx(length)
        at = start + position[:, None] / length * (end - start)
        d = sim.displacements(machine, at, np.array(sim.THREE["T1"])) @ (end - start) / length
        deviations.append((table.numbers("deviation")[rows] - (d - d[0]))[1:] / table.numbers("std")[rows][1:])
    assert np.abs(deviations).max() < 4
    assert 0.4 < np.sqrt(np.mean(np.square(deviations))) < 1.6


def test_one_point_and_many_are_displaced_alike() -> None:
    """The tests' own two formulas."""
    rng = np.random.default_rng(19)
    machine = sim.random_machine(rng, "ZXY")
    positions, tool = sim.commands(rng, 20), np.array([1.0, 2.0, 30.0])
    assert np.allclose(
        sim.displacements(machine, positions, tool), [machine.first_order(p, tool) for p in positions], atol=1e-15
    )


@pytest.mark.parametrize("apart", ["[80 mm, 0 mm, 60 mm]", "[2 mm, 1 mm, 118 mm]"], ids=["far apart", "2 mm apart"])
def test_tools_under_each_others_names_are_named(apart: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """The points had no shape of the commanded ones, or the beam of the tracker an offset of 2 m."""
    assert metrocli("init", tmp_path / "p", "--sample", "machine-methods").code == 0
    job = tmp_path / "p/jobs/standstill.yaml"
    job.write_text(job.read_text().replace("T2: [80 mm, 0 mm, 60 mm]", f"T2: {apart}"))
    assert metrocli("simulate", job, "--seed", 3, "--out", tmp_path / "new").code == 0
    (tmp_path / "p/data/points.csv").write_text((tmp_path / "new/points.csv").read_text())
    assert metrocli("calibrate-machine", job).code == 0
    job.write_text(job.read_text().replace("T1:", "T4:").replace("T2:", "T1:").replace("T4:", "T2:"))
    ran = metrocli("calibrate-machine", job)
    assert ran.code in (3, 6) and "the tools T2 and T1 are under each other's names" in ran.out + ran.err, ran.err
