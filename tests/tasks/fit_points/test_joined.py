"""Covariances of both lists, and several stations at once, against an independent generalised least squares."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from metrocli.errors import InputError, UndeterminedError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.fit_points import task as fit_points
from metrocli.tasks.fit_points.settings import Inputs, Settings
from tests.tasks.fit_points.generalised import Reference

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
TURNS = [Rotation.identity(), Rotation.from_euler("xyz", [0.3, -1.1, 2.4]), Rotation.from_euler("xyz", [-0.5, 0.4, -2])]
SHIFTS = np.array([[0.0, 0, 0], [120, -40, 900], [-700, 300, 50]])


def fitted(measured: Table | Result, nominal: Table | Result | None = None, **more: Any) -> Result:
    settings = Settings(Inputs(points=Path("-"), nominal=Path("-")), **more)
    return fit_points.run(fit_points.TASK.job(settings, measured, nominal))


def spreads(n: int, rng: np.random.Generator, size: float) -> Array:
    """Covariances of n points, (n, 3, 3), long in one direction."""
    roots = rng.normal(0, size, (n, 3, 3))
    return roots @ np.swapaxes(roots, 1, 2) + size**2 / 4 * np.eye(3)


def table(names: list[str], places: Array, covariance: Array | None = None, **more: Any) -> Table:
    columns = {**more, "point": names, "x y z [mm]": places}
    if covariance is not None:
        columns["sigma_x sigma_y sigma_z [mm]"] = np.sqrt(np.einsum("nkk->nk", covariance))
        for a, b in ("xy", "xz", "yz"):
            columns[f"cov_{a}{b}_mm2"] = covariance[:, "xyz".index(a), "xyz".index(b)]
    return Table.of(columns)


def named(count: int) -> list[str]:
    return [f"P{i}" for i in range(count)]


def measured_by(result: Table, joint: Array) -> Result:
    """A result whose points have errors in common."""
    n = len(joint) // 3
    each = np.stack([joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(n)])
    arrays = {"points_covariance": each, "points_common": np.eye(3 * n).reshape(n, 3, 3 * n), "points_core": joint}
    return Result("multilaterate", "", (), np.zeros((0, 0)), {}, {"points": result}, arrays)


def numbers(result: Result) -> Array:
    return np.array([one.value for one in result.estimates])


def agree(result: Result, expected: tuple[Array, Array, Array, Array]) -> None:
    """Hold values to 1e-9 mm (and 1e-11 rad), covariances to 1e-6 of what two standard deviations allow."""
    values, covariance = expected[:2]
    lengths = np.array([one.unit == "mm" for one in result.estimates])
    off = np.abs(numbers(result) - values)
    assert off[lengths].max() < 1e-9 and off[~lengths].max() < 1e-11
    std = np.sqrt(np.diag(covariance))
    assert np.abs((result.covariance - covariance) / np.outer(std, std)).max() < 1e-6


@pytest.mark.alike
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("joint", [False, True])
def test_covariances_of_both_lists(joint: bool, scaled: bool) -> None:
    rng, n = np.random.default_rng(3), 9
    true = rng.uniform(-500, 500, (n, 3))
    of_x, of_goal = block_diag(*spreads(n, rng, 0.02)), block_diag(*spreads(n, rng, 0.03))
    if joint:
        of_x, of_goal = (c + (f := rng.normal(0, 0.03, (3 * n, 6))) @ f.T for c in (of_x, of_goal))
    x = (TURNS[1].inv().apply(true - SHIFTS[1]).ravel() + np.linalg.cholesky(of_x) @ rng.normal(size=3 * n)).reshape(
        -1, 3
    )
    goal = true + (np.linalg.cholesky(of_goal) @ rng.normal(size=3 * n)).reshape(-1, 3)
    own = [np.stack([c[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(n)]) for c in (of_x, of_goal)]
    lists = [table(named(n), places, each) for places, each in zip((x, goal), own, strict=True)]
    given = [measured_by(one, c) for one, c in zip(lists, (of_x, of_goal), strict=True)] if joint else lists
    rows = np.arange(n)
    reference = Reference(0 * rows, rows, x, of_x, goal, of_goal, scaled=scaled)
    agree(fitted(*given, scale=scaled), reference.solved([TURNS[1]], SHIFTS[1:2]))


def test_points_of_a_free_network_have_no_error_of_their_datum() -> None:
    """A singular joint covariance: the fit of the exact list is that of the covariance with small errors of the datum."""
    rng, n = np.random.default_rng(5), 7
    true = rng.uniform(-500, 500, (n, 3))
    cross = np.cross(np.eye(3)[None], (true - true.mean(axis=0))[:, None]).transpose(0, 2, 1)
    datum = np.linalg.qr(np.concatenate([np.tile(np.eye(3), (n, 1)), cross.reshape(3 * n, 3)], axis=1))[0]
    inner = np.eye(3 * n) - datum @ datum.T
    joint = inner @ block_diag(*spreads(n, rng, 0.02)) @ inner
    x = (TURNS[1].inv().apply(true - SHIFTS[1]).ravel() + 0.01 * inner @ rng.normal(size=3 * n)).reshape(-1, 3)
    result = fitted(measured_by(table(named(n), x), joint), table(named(n), true))
    rows = np.arange(n)
    small = joint + 1e-9 * datum @ datum.T
    expected = Reference(0 * rows, rows, x, small, true, None, exact=True).solved([TURNS[1]], SHIFTS[1:2])
    assert np.abs(numbers(result) - expected[0])[:3].max() < 2e-6  # a ten-thousandth of the noise


def seen(seed: int, size: float) -> tuple[Table, Reference]:
    """Ten points that three stations see in part: the third shares none with the first that lie across."""
    rng = np.random.default_rng(seed)
    place = np.random.default_rng(11).uniform(-500, 500, (10, 3))
    views = [[0, 1, 2, 3, 4, 5], [2, 3, 4, 5, 6, 7], [5, 6, 7, 8, 9]]
    station, of = (
        np.concatenate(part) for part in zip(*((np.full(len(v), i), v) for i, v in enumerate(views)), strict=True)
    )
    covariance = spreads(len(of), np.random.default_rng(2), size)
    noise = np.einsum("nab,nb->na", np.linalg.cholesky(covariance), rng.normal(size=(len(of), 3)))
    exact = np.stack([TURNS[i].inv().apply(place[j] - SHIFTS[i]) for i, j in zip(station, of, strict=True)])
    names = [f"P{j}" for j in of]
    points = table(names, exact + noise, covariance, **{"station [text]": [f"S{i + 1}" for i in station]})
    return points, Reference(station, of, exact + noise, block_diag(*covariance), place, None, fixed=True)


@pytest.mark.parametrize("scaled", [False, True])
def test_stations_that_share_points(scaled: bool) -> None:
    points, reference = seen(1, 0.02)
    reference.scaled = scaled
    result = fitted(points, scale=scaled)
    expected = reference.solved(TURNS, SHIFTS)
    agree(result, expected)
    ends = ["x", "y", "z", "alpha", "beta", "gamma", *(["scale"] if scaled else [])]
    assert [one.name for one in result.estimates] == [f"{station}.{end}" for station in ("S2", "S3") for end in ends]
    of_points = result.tables["points"]
    assert np.abs(of_points.stacked("xyz") - expected[2]).max() < 1e-9
    std = np.sqrt(np.diag(expected[3])).reshape(-1, 3)
    assert np.abs(of_points.stacked(["sx", "sy", "sz"]) / std - 1).max() < 1e-6
    common = result.arrays["points_common"].reshape(30, -1)
    shared = common @ result.arrays["points_core"] @ common.T
    apart = ~np.kron(np.eye(10, dtype=bool), np.ones((3, 3), dtype=bool))
    assert np.abs((shared - expected[3]) / np.outer(std, std))[apart].max() < 1e-6


def test_stations_laid_onto_uncertain_nominal_places() -> None:
    points, reference = seen(1, 0.02)
    rng = np.random.default_rng(8)
    reference.fixed, reference.listed = False, block_diag(*spreads(10, rng, 0.05))
    reference.place = reference.place + rng.normal(0, 0.05, (10, 3))
    each = np.stack([reference.listed[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(10)])
    result = fitted(points, table(named(10), reference.place, each))
    agree(result, reference.solved(TURNS, SHIFTS))
    assert result.estimates[0].name == "S1.x"


@pytest.mark.slow
def test_stated_uncertainties_hold() -> None:
    z: list[Array] = []
    for seed in range(40):
        points, reference = seen(100 + seed, 0.03)
        result = fitted(points)
        truth = np.column_stack([SHIFTS, [turn.as_euler("xyz") for turn in TURNS]])[1:].ravel()
        moved = result.tables["points"]
        z.append((numbers(result) - truth) / [one.std for one in result.estimates])
        z.append(((moved.stacked("xyz") - reference.place) / moved.stacked(["sx", "sy", "sz"])).ravel())
    assert 0.9 < np.sqrt(np.mean(np.square(np.concatenate(z)))) < 1.1


def changed(points: Table, row: int, by: tuple[float, float, float]) -> Table:
    columns = {name: values.copy() for name, values in points.columns.items()}
    for axis, size in zip("xyz", by, strict=True):
        columns[axis][row] += size
    return Table(columns, points.units)


def test_a_wrong_point_of_a_station_is_a_suspect() -> None:
    points, _ = seen(1, 0.01)
    result = fitted(changed(points, 9, (0.6, -0.5, 0.4)))
    worst = result.tables["suspects"]
    assert "P5" in worst.texts("point")[:2] and "P5" in result.warnings[-1]


def test_a_moved_point_is_a_suspect_under_a_joint_covariance() -> None:
    rng, n = np.random.default_rng(6), 10
    true = rng.uniform(-500, 500, (n, 3))
    joint = 1e-4 * np.eye(3 * n) + (f := rng.normal(0, 0.05, (3 * n, 4))) @ f.T
    x = TURNS[1].inv().apply(true - SHIFTS[1])
    x[4] += [0.2, 0.1, -0.2]
    result = fitted(measured_by(table(named(n), x), joint), table(named(n), true))
    assert result.tables["suspects"].texts("point")[0] == "P4"


def station_table(rows: list[tuple[str, str, Array]], **more: Any) -> Table:
    return Table.of(
        {
            "station [text]": [row[0] for row in rows],
            "point [text]": [row[1] for row in rows],
            "x y z [mm]": np.array([row[2] for row in rows]),
            **more,
        }
    )


def two_stations(shared: Array, mirror: Array | float = 1.0) -> list[tuple[str, str, Array]]:
    rng = np.random.default_rng(4)
    there = (TURNS[1].inv().apply(shared - SHIFTS[1]) + rng.normal(0, 0.01, shared.shape)) * mirror
    return [(s, f"P{i}", p) for s, places in (("A", shared), ("B", there)) for i, p in enumerate(places)]


def test_what_cannot_be_joined_is_refused() -> None:
    place = np.random.default_rng(7).uniform(-500, 500, (7, 3))
    line = np.linspace(0, 1, 5)[:, None] * [100.0, 50, 20]
    with pytest.raises(UndeterminedError, match=r"station B cannot be joined: it has 2 known points \(P0, P1\)"):
        fitted(station_table([row for row in two_stations(place) if row[0] == "A" or row[1] in ("P0", "P1")]))
    with pytest.raises(UndeterminedError, match="on a line"):
        fitted(
            station_table(
                [("A", f"P{i}", p) for i, p in enumerate(line)] + [("B", f"P{i}", p) for i, p in enumerate(line)]
            )
        )
    with pytest.raises(InputError, match="the points of station B are a mirror image of the others"):
        fitted(station_table(two_stations(place, np.array([1.0, -1, 1]))))
    rows = two_stations(place)
    rows[9], rows[11] = ("B", "P4", rows[9][2]), ("B", "P2", rows[11][2])
    with pytest.raises(InputError, match="points P4 and P2 are exchanged at station B"):
        fitted(station_table(rows))
    with pytest.raises(InputError, match="all points are of station A: there is nothing to lay it onto"):
        fitted(station_table([row for row in two_stations(place) if row[0] == "A"]))
    with pytest.raises(InputError, match="no coordinate is exact"):
        fitted(station_table(two_stations(place), **{"sigma [mm]": np.zeros(14)}))


def test_covariances_that_cannot_be_are_refused() -> None:
    place = np.random.default_rng(7).uniform(-500, 500, (4, 3))
    good = table(named(4), place, np.tile(1e-4 * np.eye(3), (4, 1, 1)))
    good.columns["cov_xy_mm2"][2] = 2e-4  # type: ignore[index]
    with pytest.raises(InputError, match="larger than the standard deviations allow"):
        fitted(good, table(named(4), place))


def test_measured_points_without_sigma_have_noise_on_exact_places() -> None:
    place = np.random.default_rng(7).uniform(-500, 500, (6, 3))
    exact = Table.of({"point": named(6), "x y z [mm]": place, "sigma [mm]": np.zeros(6)})
    measured = table(named(6), place + np.random.default_rng(1).normal(0, 0.05, (6, 3)))
    both = [fitted(measured, nominal, noise=0.05) for nominal in (exact, table(named(6), place))]
    assert both[0].estimates == both[1].estimates and both[0].estimates[0].std > 0.02


def test_noise_of_stations_is_estimated() -> None:
    place = np.random.default_rng(9).uniform(-500, 500, (30, 3))
    result = fitted(station_table(two_stations(place)))
    assert 0.7 < result.statistics["noise"] / (0.01 / np.sqrt(2)) < 1.3
    assert result.statistics["dof"] == 84


def test_noise_of_stations_is_estimated_beside_uncertain_nominal_places() -> None:
    place, found = np.random.default_rng(9).uniform(-500, 500, (6, 3)), list[float]()
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rows = [(s, f"P{i}", p) for s in "ABC" for i, p in enumerate(place + rng.normal(0, 0.01, place.shape))]
        nominal = Table.of(
            {"point": named(6), "x y z [mm]": place + rng.normal(0, 0.1, place.shape), "sigma [mm]": np.full(6, 0.1)}
        )
        noise = fitted(station_table(rows), nominal).statistics["noise"]
        assert isinstance(noise, float)
        found.append(noise)
    assert 0.9 < np.sqrt(np.mean(np.square(found))) / 0.01 < 1.1


def test_a_job_of_stations_and_one_onto_its_points(
    metrocli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    points, _ = seen(1, 0.02)
    place = points.stacked("xyz")
    rows = zip(points.texts("station"), points.texts("point"), place, strict=True)
    text = [f"{station},{name},{p[0]:.5f},{p[1]:.5f},{p[2]:.5f},0.04" for station, name, p in rows]
    Path("all.csv").write_text("\n".join(["station,point,x_mm,y_mm,z_mm,sigma_mm", *text]))
    Path("third.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *(t[3:] for t in text if t[:2] == "S3")]))
    head = "metrocli: 1\njob: fit-points\n"
    Path("all.yaml").write_text(head + "inputs: {points: all.csv}\nrequire: {S2.x.std: < 1 mm}\noutput: all.h5\n")
    Path("next.yaml").write_text(head + "inputs: {points: third.csv, nominal: all.h5}\noutput: next.h5\n")
    ran = metrocli("fit-points", "all.yaml")
    assert ran.code == 0 and "S3.gamma" in ran.out, ran.err
    refused = metrocli("diagnose", "all.yaml")
    assert refused.code == 3 and "several stations at once cannot be diagnosed" in refused.err
    assert metrocli("fit-points", "next.yaml").code == 0
    assert metrocli("diagnose", "next.yaml").code == 0
