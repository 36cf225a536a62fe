"""A raw part that is measured warm: its points at 20 degC, and the uncertainty of its growth in the targets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from simulated.castings import Array, Casting, casting
from simulated.lengths import network, settings
from tasks.fit_part.test_fit import Metrocli, fitted

from metrocli.errors import InputError
from metrocli.result import Result
from metrocli.settings import KnownQuantity
from metrocli.tasks.fit_part.readings import read
from metrocli.tasks.fit_part.settings import Inputs, Overstock, Settings
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.shared.part import Part

STEEL = "part: {temperature: {value: 25 degC, std: 0.5 K}, expansion: {value: 11.5e-6 1/K, std: 1e-6 1/K}}"
GROWTH = 5 * 11.5e-6


def warmed(one: Casting, growth: float) -> Casting:
    """The casting grown about a point that no part of it is near."""
    about = np.array([-3000.0, 2000, 500])
    points, targets = ((at - about) * (1 + growth) + about for at in (one.points, one.targets))
    return replace(one, points=points, targets=targets)


def targets(result: Result) -> Array:
    return result.tables["targets"].stacked(("x", "y", "z"))


def covariance(result: Result) -> Array:
    """The joint covariance of all targets (3 m, 3 m), from its factors."""
    common = result.arrays["targets_common"].reshape(targets(result).size, -1)
    return block_diag(*result.arrays["targets_own"]) + common @ common.T


@pytest.mark.slow
def test_targets_of_a_warm_part_are_those_of_the_cold_one(tmp_path: Path, metrocli: Metrocli) -> None:
    cold = casting(11)
    expected = targets(fitted(cold.write(tmp_path), metrocli))
    warm = warmed(cold, GROWTH)
    unaware = targets(fitted(warm.write(tmp_path), metrocli))
    found = fitted(warm.write(tmp_path, STEEL), metrocli)
    assert np.abs(unaware - expected).max() > 0.02
    assert targets(found) == pytest.approx(expected, abs=1e-6)
    assert found.statistics["growth"] == pytest.approx(GROWTH)
    assert any("20 degC" in note for note in found.notes)


@pytest.mark.slow
def test_targets_have_the_uncertainty_of_the_growth_in_common(tmp_path: Path, metrocli: Metrocli) -> None:
    """`u(g)^2 D D'` comes to their joint covariance, with D from fits to parts that grew by more and by less."""
    one, h = casting(11), 1e-4
    exact = fitted(one.write(tmp_path), metrocli)
    unsure = STEEL.replace("25 degC", "20 degC")
    found = fitted(one.write(tmp_path, unsure), metrocli)
    more, less = (targets(fitted(warmed(one, g).write(tmp_path), metrocli)).ravel() for g in (h, -h))
    by_growth = (more - less) / (2 * h)
    std = np.sqrt((11.5e-6 * 0.5) ** 2 + (1e-6 * 0.5) ** 2)
    expected = std**2 * np.outer(by_growth, by_growth)
    added = covariance(found) - covariance(exact)
    assert np.abs(by_growth).max() > 300
    assert np.abs(added - expected).max() < 0.01 * np.abs(expected).max()


def test_the_overstock_has_no_uncertainty_of_where_the_part_stood(tmp_path: Path, metrocli: Metrocli) -> None:
    one, far = casting(11), np.array([2e4, 0, 0])
    away = replace(one, points=one.points + far, targets=one.targets + far)
    here, there = (fitted(at.write(tmp_path, STEEL), metrocli).tables["overstock"] for at in (one, away))
    assert there.numbers("overstock") == pytest.approx(here.numbers("overstock"), abs=1e-6)
    assert there.numbers("s_overstock") == pytest.approx(here.numbers("s_overstock"), rel=1e-5)


def test_points_that_are_at_20_degc_are_not_taken_there_again(tmp_path: Path) -> None:
    net, part = network(20, 5, noise=0.0), Part(KnownQuantity(25.0, 0.5), KnownQuantity(11.5e-6, 1e-6))
    cold = multilaterate.run(multilaterate.TASK.job(replace(settings(), part=part), net.lengths(), net.point_table()))
    job = Settings(Inputs(points=Path("points.h5"), nominal=Path("part.yaml")), Overstock(0.5), part=part)
    with pytest.raises(InputError, match="at 20 degC already"):
        read(job, cold, (), of_mesh=True)
    kept = read(replace(job, part=None), cold, (), of_mesh=True)
    assert kept.growth == pytest.approx({"growth": part.growth, "growth_std": part.std})
