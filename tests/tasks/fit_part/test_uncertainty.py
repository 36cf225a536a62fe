"""Covariance of the fitted pose against fits to points with errors, and the Monte Carlo check of a job."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated.castings import Array, casting, nominal
from tasks.fit_part.test_fit import SCALE, Metrocli, fitted

from metrocli.errors import Fault
from metrocli.geometry import poses
from metrocli.project import yaml_text
from metrocli.settings import Section
from metrocli.tasks.fit_part.fit import Aim, Fit, most
from metrocli.tasks.fit_part.ideal import ideal
from metrocli.tasks.fit_part.nominals import OfSurfaces
from metrocli.tasks.fit_part.settings import NominalFile
from metrocli.tasks.fit_part.solve import fitted_part
from metrocli.tasks.fit_part.stock import Stock
from metrocli.tasks.fit_part.uncertainty import of_result, sensitivity


def ideal_of(folder: Path) -> OfSurfaces:
    """The ideal part of the castings."""
    (folder / "part.yaml").write_text(nominal())
    faults: list[Fault] = []
    node = yaml_text.parse((folder / "part.yaml").read_text(), "part.yaml", folder, faults)
    part = ideal(Section(NominalFile).read(node, faults))
    assert isinstance(part, OfSurfaces) and not faults
    return part


@pytest.mark.parametrize(("aim", "minimum"), [("even", 0.5), ("even", 2.3), ("least-motion", 0.5), ("most", 0.5)])
def test_the_sensitivity_is_the_difference_of_two_fits(aim: str, minimum: float, tmp_path: Path) -> None:
    one = casting(33)
    start = np.zeros(6)
    part = ideal_of(tmp_path)
    surface = np.array([part.names.index(name) for name in one.surface])
    near = poses.inverse(poses.pose_from_euler(one.pose[:3], one.pose[3:]))

    def at(points: Array) -> tuple[Aim, Fit]:
        stock = Stock(part, points, surface)
        return fitted_part(stock, aim, minimum, most(stock, near), start)

    chosen, fit = at(one.points)
    assert (fit.duals > 0).any() == (aim != "even" or minimum > 1)
    covariance = np.broadcast_to(np.eye(3), (len(one.points), 3, 3))
    found = sensitivity(fit, chosen, start, covariance)
    along = np.random.default_rng(2).normal(size=one.points.shape)
    h = 1e-3 if aim == "most" else 1e-4
    ahead, behind = (poses.inverse(at(one.points + side * h * along)[1].into) for side in (1, -1))
    difference = poses.euler_form(ahead) - poses.euler_form(behind)
    expected = of_result(fit) @ np.einsum("nij,nj->i", found.by_point, along)
    assert np.allclose(difference / (2 * h) / SCALE, expected / SCALE, atol=0.02 * np.abs(expected / SCALE).max())
    summed = np.einsum("nij,nkj->ik", found.by_point, found.by_point)
    assert np.allclose(found.covariance, summed)


def test_the_monte_carlo_check_repeats_the_standard_uncertainties(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(32)
    result = fitted(one.write(tmp_path, "monte_carlo: {trials: 60, seed: 3}"), metrocli)
    ratio = result.tables["monte_carlo"].numbers("ratio")
    assert (np.abs(ratio - 1) < 0.3).all() and result.statistics["monte_carlo_trials"] == 60
    assert any("Monte Carlo: 60 of 60 fits" in note and "agree with it" in note for note in result.notes)


def test_exact_points_have_no_uncertainty_and_a_warning(tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(32).write(tmp_path)
    points = tmp_path / "points.csv"
    rows = [line.split(",") for line in points.read_text().splitlines()]
    points.write_text("\n".join(",".join([*row[:4], row[5]]) for row in rows) + "\n")
    ran = metrocli("fit-part", job)
    assert ran.code == 0 and "the points are taken as exact" in ran.err
    result = fitted(job, metrocli, "--set", "noise=0.05 mm")
    assert all(one.std > 0 for one in result.estimates)
