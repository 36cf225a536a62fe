"""Covariance of the fitted pose against fits to points with errors, and the Monte Carlo check of a job."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from simulated.castings import Array, Casting, casting, nominal
from tasks.fit_part.test_fit import SCALE, Metrocli, dense, even, fitted, moved

from metrocli.errors import Fault
from metrocli.geometry import poses
from metrocli.project import yaml_text
from metrocli.result import Result
from metrocli.settings import Section
from metrocli.table import Table
from metrocli.tasks.fit_part.draws import drawing, sensitivity_of_draws
from metrocli.tasks.fit_part.fit import PoseCriterion, PoseFit, max_least_overstock, max_least_overstock_of_many
from metrocli.tasks.fit_part.ideal import ideal
from metrocli.tasks.fit_part.nominals import OfSurfaces
from metrocli.tasks.fit_part.report import report
from metrocli.tasks.fit_part.settings import Inputs, NominalFile, Overstock, Settings
from metrocli.tasks.fit_part.solve import FittedPart, fitted_part, prepare, solve
from metrocli.tasks.fit_part.stock import Stock
from metrocli.tasks.fit_part.uncertainty import pose_by_step, sensitivity
from metrocli.uncertainty.predicted import PredictedPlaces

EXCHANGED = 32
"""A casting whose pose other points come to hold, with errors of the usual size"""
AT_THE_MINIMUM = [("even", 2.289, 46), ("least-motion", 3.163, 43)]
"""Aims, minimum [mm] and castings of which the same is true"""


def file_of(folder: Path) -> NominalFile:
    """The ideal part of the castings, as read from its file."""
    faults: list[Fault] = []
    part = Section(NominalFile).read(yaml_text.parse(nominal(), "part.yaml", folder, faults), faults)
    assert not faults
    return part


def ideal_of(folder: Path) -> OfSurfaces:
    """The ideal part of the castings."""
    part = ideal(file_of(folder))
    assert isinstance(part, OfSurfaces)
    return part


def solved_of(one: Casting, part: NominalFile, aim: str = "most", minimum: float = 0.5) -> FittedPart:
    """What a job gives."""
    columns = {"point": np.array([f"P{n}" for n in range(len(one.points))]), "surface": one.surface}
    places = {axis: one.points[:, k] for k, axis in enumerate("xyz")}
    settings = Settings(
        Inputs(points=Path("points.csv"), nominal=Path("part.yaml")), Overstock(minimum, aim), noise=one.sigma
    )
    return solve(settings, prepare(settings, part, Table({**columns, **places})))


@pytest.mark.alike
@pytest.mark.parametrize(("aim", "minimum"), [("even", 0.5), ("even", 2.3), ("least-motion", 0.5), ("most", 0.5)])
def test_the_sensitivity_is_the_difference_of_two_fits(aim: str, minimum: float, tmp_path: Path) -> None:
    one = casting(33)
    start = np.zeros(6)
    part = ideal_of(tmp_path)
    surface = np.array([part.names.index(name) for name in one.surface])
    near = poses.inverse(poses.pose_from_euler(one.pose[:3], one.pose[3:]))

    def at(points: Array) -> tuple[PoseCriterion, PoseFit]:
        stock = Stock(part, points, surface)
        return fitted_part(stock, aim, minimum, max_least_overstock(stock, near), start)

    chosen, fit = at(one.points)
    assert (fit.duals > 0).any() == (aim != "even" or minimum > 1)
    rng = np.random.default_rng(2)
    own = np.broadcast_to(np.eye(3), (len(one.points), 3, 3))
    places = PredictedPlaces(one.points, rng.normal(size=(len(one.points), 3, 2)), np.diag([4.0, 9.0]), own)
    found = sensitivity(fit, chosen, start, places)
    along = rng.normal(size=one.points.shape)
    h = 1e-3 if aim == "most" else 1e-4
    ahead, behind = (poses.inverse(at(one.points + side * h * along)[1].to_part) for side in (1, -1))
    difference = poses.euler_form(ahead) - poses.euler_form(behind)
    expected = pose_by_step(fit) @ np.einsum("nij,nj->i", found.by_point, along)
    assert np.allclose(difference / (2 * h) / SCALE, expected / SCALE, atol=0.02 * np.abs(expected / SCALE).max())
    every = np.concatenate(list(found.by_point), axis=1)
    shared = places.common.reshape(-1, 2)
    joint = np.eye(len(shared)) + 4 * np.outer(shared[:, 0], shared[:, 0]) + 9 * np.outer(shared[:, 1], shared[:, 1])
    assert np.allclose(found.covariance, every @ joint @ every.T)


def by_hand(one: Casting, errors: Array, near: Array) -> Array:
    """The pose with the largest least overstock, then even, by two plain programmes with all points, twice."""
    pose, points = near, one.points + errors
    for _ in range(2):
        overstock = one.overstock_at(pose, points)
        steps = 1e-4 * np.diag(SCALE)
        rows = np.stack(
            [(one.overstock_at(pose + s, points) - one.overstock_at(pose - s, points)) / 2e-4 for s in steps], axis=1
        )
        limits = [*[(-20.0, 20.0)] * 6, (None, None)]
        against = np.column_stack([-rows, np.ones(len(rows))])
        highest = linprog([0, 0, 0, 0, 0, 0, -1], against, overstock, bounds=limits).x
        even = minimize(
            lambda x, o=overstock, rows=rows: float((o + rows @ x).var()),
            highest[:6],
            jac=lambda x, o=overstock, rows=rows: 2 * (rows - rows.mean(axis=0)).T @ (o + rows @ x) / len(o),
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda x, o=overstock, rows=rows, t=highest[6]: o + rows @ x - t + 1e-7,
                "jac": lambda x, rows=rows: rows,
            },
            options={"ftol": 1e-12},
        ).x
        pose = pose + even * SCALE
    return pose


@pytest.mark.slow
def test_the_largest_least_overstock_scatters_as_stated_while_its_points_change(tmp_path: Path) -> None:
    """Where other points come to hold the pose: a derivative with the same points is too small by half."""
    one, part = casting(EXCHANGED), file_of(tmp_path)
    result = report(solved_of(one, part))
    stated = np.array([estimate.std for estimate in result.estimates])
    pose = np.array([estimate.value for estimate in result.estimates])
    rng = np.random.default_rng(3)
    assert by_hand(one, np.zeros_like(one.points), pose) / SCALE == pytest.approx(pose / SCALE, abs=1e-4)
    drawn = [by_hand(one, one.sigma * rng.normal(size=one.points.shape), pose) - pose for _ in range(100)]
    ratio = np.sqrt(np.mean(np.square(drawn), axis=0)) / stated
    assert np.abs(ratio - 1).max() < 0.25  # 3 standard deviations of 200 draws against 100


@pytest.mark.slow
@pytest.mark.parametrize(("aim", "minimum", "seed"), AT_THE_MINIMUM)
def test_a_pose_held_at_the_minimum_scatters_as_stated_while_its_points_change(
    aim: str, minimum: float, seed: int, tmp_path: Path
) -> None:
    """Of these a derivative with the same points is too small by half or more."""
    one = casting(seed)
    solved = solved_of(one, file_of(tmp_path), aim, minimum)
    stated = report(solved).covariance
    pose = np.array([estimate.value for estimate in report(solved).estimates])
    value = even(one) if aim == "even" else moved(one)
    rng = np.random.default_rng(4)

    def by_dense_solver(errors: Array) -> Array:
        changed = replace(one, points=one.points + errors)
        return dense(changed, pose, even(changed) if aim == "even" else moved(changed), minimum)

    assert value(pose) == pytest.approx(value(by_dense_solver(np.zeros_like(one.points))), rel=1e-6)
    steps = [(by_dense_solver(one.sigma * rng.normal(size=one.points.shape)) - pose) / SCALE for _ in range(40)]
    covariance = stated / np.outer(SCALE, SCALE)
    ratio = np.sqrt(np.mean(np.square(steps), axis=0) / np.diag(covariance))
    assert np.abs(ratio - 1).max() < 0.35  # 3 standard deviations of 40 draws
    squares = np.einsum("ni,ni->n", steps, np.linalg.solve(covariance, np.transpose(steps)).T)
    assert (squares < 12.5916).mean() > 0.85  # 95 % by chi-square with 6 degrees of freedom


@pytest.mark.slow
def test_a_shift_of_all_points_is_a_shift_of_the_pose_in_each_draw(tmp_path: Path) -> None:
    one, part = casting(33), ideal_of(tmp_path)
    stock = Stock(part, one.points, np.array([part.names.index(name) for name in one.surface]))
    near = poses.inverse(poses.pose_from_euler(one.pose[:3], one.pose[3:]))
    aim, fit = fitted_part(stock, "most", 0.5, max_least_overstock(stock, near), np.zeros(6))
    shift = np.broadcast_to(np.eye(3), (len(one.points), 3, 3))
    places = PredictedPlaces(one.points, shift, 0.04 * np.eye(3), 9e-4 * shift)
    found = sensitivity_of_draws(fit, aim, np.zeros(6), places)
    moved = pose_by_step(fit) @ found.by_common
    assert moved[:3] == pytest.approx(np.eye(3), abs=1e-6) and np.abs(moved[3:]).max() < 1e-8
    independent = PredictedPlaces(one.points, shift[:, :, :0], np.zeros((0, 0)), 9e-4 * shift)
    alone = sensitivity_of_draws(fit, aim, np.zeros(6), independent)
    # the shift moves the pose and nothing else: what remains is what independent errors do, by other draws
    size = np.sqrt(np.diag(alone.own))
    assert np.sqrt(np.diag(found.own)) == pytest.approx(size, rel=0.15)


def test_the_largest_least_overstock_of_many_points_is_that_of_all(tmp_path: Path) -> None:
    one, part = casting(35, each=150, angle=0.3), ideal_of(tmp_path)
    stock = Stock(part, one.points, np.array([part.names.index(name) for name in one.surface]))
    off = one.pose + np.array([40, -25, 30, 0.02, -0.03, 0.02])  # where other points are the lowest
    pose, least, duals = max_least_overstock_of_many(stock, poses.inverse(poses.pose_from_euler(off[:3], off[3:])))
    back = poses.inverse(pose)
    overstock = one.overstock_at(np.concatenate([back[:3], poses.euler_form(back)[3:]]))
    assert overstock.min() == pytest.approx(least, abs=1e-9)
    assert np.allclose(overstock[duals > 0], least, atol=1e-6)
    assert duals.sum() == pytest.approx(1)
    assert least == pytest.approx(max_least_overstock(stock, pose)[1], abs=1e-6)


def test_the_monte_carlo_check_repeats_the_standard_uncertainties(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(32)
    result = fitted(one.write(tmp_path, "monte_carlo: {trials: 60, seed: 3}"), metrocli)
    ratio = result.tables["monte_carlo"].numbers("ratio")
    assert (np.abs(ratio - 1) < 0.3).all() and result.statistics["monte_carlo_trials"] == 60
    assert any("Monte Carlo: 60 of 60 fits" in note and "agree with it" in note for note in result.notes)


@pytest.mark.slow
def test_errors_that_points_share_move_pose_and_targets_together(tmp_path: Path) -> None:
    """Points of a network with a common scale and a bending: targets against fits to points with these errors."""
    one = casting(34)
    part = file_of(tmp_path)
    places = np.concatenate([one.points, one.targets])
    middle = places - places.mean(axis=0)
    bent = np.zeros_like(places)
    bent[:, 2] = 1e-7 * middle[:, 0] ** 2
    common = np.stack([1e-4 * places, bent], axis=2)
    own = np.broadcast_to(1e-8 * np.eye(3), (len(places), 3, 3))

    def of(points: Array) -> Result:
        names = [f"P{n}" for n in range(len(one.points))] + [f"T{n}" for n in range(len(one.targets))]
        table = Table({"point": np.array(names), **{axis: points[:, k] for k, axis in enumerate("xyz")}})
        whole = own + common @ np.swapaxes(common, 1, 2)
        arrays = {"points_covariance": whole, "points_common": common, "points_core": np.eye(2)}
        named = {name: tuple(f"P{n}" for n in np.flatnonzero(one.surface == name)) for name in np.unique(one.surface)}
        files = Inputs(points=Path("points.h5"), nominal=Path("part.yaml"))
        settings = Settings(files, Overstock(0.5), targets=("T*",), surfaces=named)
        result = Result("calibrate-camera", "", (), np.zeros((0, 0)), {}, {"points": table}, arrays)
        return report(solve(settings, prepare(settings, part, result)))

    found = of(places)
    at = found.tables["targets"].stacked("xyz")
    moved = [of(places + common[:, :, k]).tables["targets"].stacked("xyz") - at for k in range(2)]
    expected = np.sum([np.outer(each.ravel(), each.ravel()) for each in moved], axis=0)
    shared = found.arrays["targets_common"].reshape(at.size, -1)
    assert np.allclose(shared @ shared.T, expected, atol=0.02 * np.abs(expected).max())


def test_simulated_errors_have_the_joint_covariance() -> None:
    """With a shared part that has a negative eigenvalue, as a datum on the points brings it."""
    rng = np.random.default_rng(7)
    common, core = rng.normal(size=(5, 3, 3)), np.diag([0.5, 0.2, -0.01])
    own = np.stack([np.diag(rng.uniform(0.5, 2, 3)) for _ in range(5)])
    draw = drawing(PredictedPlaces(np.zeros((5, 3)), common, core, own))
    drawn = np.array([draw(rng).ravel() for _ in range(20_000)])
    expected = common.reshape(15, 3) @ core @ common.reshape(15, 3).T
    for n in range(5):
        expected[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += own[n]
    size = np.sqrt(np.diag(expected))
    assert np.abs((drawn.T @ drawn / len(drawn) - expected) / np.outer(size, size)).max() < 0.05


def test_exact_points_have_no_uncertainty_and_a_warning(tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(32).write(tmp_path)
    points = tmp_path / "points.csv"
    rows = [line.split(",") for line in points.read_text().splitlines()]
    points.write_text("\n".join(",".join([*row[:4], row[5]]) for row in rows) + "\n")
    ran = metrocli("fit-part", job)
    assert ran.code == 0 and "the points are taken as exact" in ran.err
    result = fitted(job, metrocli, "--set", "noise=0.05 mm")
    assert all(one.std > 0 for one in result.estimates)


@pytest.mark.slow
def test_the_uncertainty_of_a_mean_overstock_keeps_what_the_points_share(tmp_path: Path) -> None:
    """Independent errors average out over a surface; those of a common shift do not."""
    one = casting(33)
    solved = solved_of(one, file_of(tmp_path))
    points = solved.prepared.readings.surface_points
    shift = np.broadcast_to(np.eye(3), (len(points.names), 3, 3))
    places = PredictedPlaces(points.points, shift, 0.04 * np.eye(3), 9e-4 * shift)
    shared = replace(solved.prepared.readings, surface_points=replace(points, places=places))
    surfaces = report(replace(solved, prepared=replace(solved.prepared, readings=shared))).tables["surfaces"]
    count = dict(zip(surfaces.texts("surface"), surfaces.numbers("points"), strict=True))
    std = dict(zip(surfaces.texts("surface"), surfaces.numbers("s_mean"), strict=True))
    assert std["top"] == pytest.approx(np.sqrt(0.04 + 9e-4 / count["top"]), rel=1e-6)
    # of a whole circle the shift cancels; of one that is measured unevenly a little is left
    assert std["boss"] < std["top"]
    assert surfaces.numbers("s_least") == pytest.approx(np.sqrt(0.04 + 9e-4), rel=1e-6)
