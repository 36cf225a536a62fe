"""Best fits against an independent generalised least squares, and what is refused or named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from metrocli.errors import InputError, UndeterminedError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.fit_points import task as fit_points
from metrocli.tasks.fit_points.settings import Inputs, Settings

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")
TURN, SHIFT = Rotation.from_euler("xyz", [0.3, -1.1, 2.4]), np.array([120.0, -40.0, 900.0])


def table(places: Array, **more: Array) -> Table:
    names = np.array([f"P{i}" for i in range(len(places))])
    return Table({"point": names, **dict(zip("xyz", places.T, strict=True)), **more}, dict.fromkeys("xyz", "mm"))


def fitted(measured: Table, nominal: Table, **more: Any) -> Result:
    settings = Settings(Inputs(points=NOWHERE, nominal=NOWHERE), **more)
    return fit_points.run(fit_points.TASK.job(settings, measured, nominal))


def values(result: Result) -> Array:
    return np.array([one.value for one in result.estimates])


def drawn(n: int, seed: int, sigma: tuple[float, float], scale: float = 1.0) -> tuple[Array, Array]:
    """Measured and nominal points with noise in both lists."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(-500, 500, (n, 3))
    return true + rng.normal(0, sigma[0], true.shape), scale * TURN.apply(true) + SHIFT + rng.normal(
        0, sigma[1], true.shape
    )


def reference(x: Array, goal: Array, of_x: Array, of_goal: Array, scaled: bool) -> Array:
    """Errors in both lists by scipy: the unknowns are the transformation and the true points."""

    def residuals(p: Array) -> Array:
        true = p[7:].reshape(-1, 3)
        moved = p[6] * Rotation.from_rotvec(p[3:6]).apply(true) + p[:3]
        tied = [] if scaled else [(p[6] - 1) * 1e9]
        return np.concatenate([((goal - moved) / of_goal).ravel(), ((x - true) / of_x).ravel(), tied])

    start = np.concatenate([SHIFT, TURN.as_rotvec(), [1.0], x.ravel()])
    found = least_squares(residuals, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return np.array([*found[:3], *Rotation.from_rotvec(found[3:6]).as_euler("xyz"), *([found[6]] if scaled else [])])


@pytest.mark.parametrize("scaled", [False, True])
def test_it_is_the_generalised_least_squares_of_both_lists(scaled: bool) -> None:
    x, goal = drawn(12, 3, (0.02, 0.05), 1 + 2e-5 * scaled)
    rng = np.random.default_rng(1)
    of_x, of_goal = rng.uniform(0.01, 0.03, x.shape), rng.uniform(0.03, 0.08, x.shape)
    sigma = {f"sigma_{axis}": column for axis, column in zip("xyz", of_x.T, strict=True)}
    of_nominal = {f"sigma_{axis}": column for axis, column in zip("xyz", of_goal.T, strict=True)}
    result = fitted(table(x, **sigma), table(goal, **of_nominal), scale=scaled, noise=1.0)
    expected = reference(x, goal, of_x, of_goal, scaled)
    assert np.abs(values(result)[:3] - expected[:3]).max() < 1e-7
    assert np.abs(values(result)[3:] - expected[3:]).max() < 1e-10


def test_exact_lists_are_laid_onto_each_other_exactly() -> None:
    x, goal = drawn(6, 5, (0.0, 0.0))
    result = fitted(table(x), table(goal), noise=0.01)
    assert np.abs(values(result)[:3] - SHIFT).max() < 1e-9
    assert np.abs(result.tables["points"].stacked(["dx", "dy", "dz"])).max() < 1e-9


def test_rounding_is_no_noise() -> None:
    """A list calculated from the other: no uncertainty of 1e-15 mm, but the sentence that nothing shows the noise."""
    measured = np.random.default_rng(4).uniform(-500, 500, (6, 3)).round(3)
    result = fitted(table(measured), table(1.001 * TURN.apply(measured) + SHIFT), scale=True)
    assert not any(estimate.std for estimate in result.estimates)
    assert not any(result.tables["points"].numbers(name).any() for name in ("sx", "dx", "dy", "dz", "d"))
    assert "fit to the rounding of their numbers" in result.warnings[0]
    assert values(result)[6] == 1.001
    noisy = fitted(table(measured), table(TURN.apply(measured) + SHIFT + 1e-9 * np.sign(measured)))
    assert noisy.estimates[0].std > 1e-10 and not noisy.warnings


@pytest.mark.parametrize("draws", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_stated_uncertainties_hold(draws: int) -> None:
    """Draws with noise in both lists: z of the transformation and of the moved points is about 1."""
    z: list[Array] = []
    moved: list[Array] = []
    truth = np.array([*SHIFT, *TURN.as_euler("xyz")])
    for seed in range(draws):
        rng = np.random.default_rng(1000 + seed)
        true = np.random.default_rng(7).uniform(-500, 500, (8, 3))
        x = true + rng.normal(0, 0.03, true.shape)
        goal = TURN.apply(true) + SHIFT + rng.normal(0, 0.04, true.shape)
        each = np.full(8, 0.03)
        result = fitted(table(x, sigma=each), table(goal, sigma=np.full(8, 0.04)))
        z.append((values(result) - truth) / [one.std for one in result.estimates])
        points = result.tables["points"]
        off = points.stacked("xyz") - (TURN.apply(true) + SHIFT)
        moved.append(off / points.stacked(["sx", "sy", "sz"]))
    assert 0.95 < np.sqrt(np.mean(np.square(z))) < 1.05
    assert 0.95 < np.sqrt(np.mean(np.square(moved))) < 1.05


def test_estimated_noise_is_that_of_coordinates_without_a_sigma() -> None:
    """Half of the points have a sigma of 4 um, the others 40 um of noise that nobody states."""
    z: list[Array] = []
    found: list[float] = []
    truth = np.array([*SHIFT, *TURN.as_euler("xyz")])
    for seed in range(40):
        rng = np.random.default_rng(2000 + seed)
        true = np.random.default_rng(7).uniform(-500, 500, (10, 3))
        each = np.where(np.arange(10) < 5, 0.004, 0.04)
        x = true + each[:, None] * rng.normal(size=true.shape)
        result = fitted(table(x, sigma=np.where(each < 0.01, each, np.nan)), table(TURN.apply(true) + SHIFT))
        z.append((values(result) - truth) / [one.std for one in result.estimates])
        noise = result.statistics["noise"]
        assert isinstance(noise, float)
        found.append(noise)
    assert 0.9 < np.sqrt(np.mean(np.square(z))) < 1.1
    assert 0.95 < np.sqrt(np.mean(np.square(found))) / 0.04 < 1.05


def test_a_3_2_1_alignment_uses_six_coordinates() -> None:
    x, goal = drawn(6, 8, (0.0, 0.0))
    used = np.full((6, 3), np.nan)
    used[:3, 2], used[3:5, 1], used[5, 0] = goal[:3, 2], goal[3:5, 1], goal[5, 0]
    result = fitted(table(x), table(used), noise=0.01)
    off = result.tables["points"].stacked("xyz") - used
    assert result.statistics["dof"] == 0 and np.nanmax(np.abs(off)) < 1e-6


def test_a_3_2_1_alignment_does_not_turn_the_part_over() -> None:
    """Six coordinates are met by four poses; the part is laid down nearly as it should be."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        goal = rng.uniform(-300, 300, (6, 3))
        goal[:3, 2], goal[3:5, 1] = 0.0, 100.0
        turn = Rotation.from_euler("xyz", rng.uniform(-0.5, 0.5, 3))
        used = np.full((6, 3), np.nan)
        used[:3, 2], used[3:5, 1], used[5, 0] = goal[:3, 2], goal[3:5, 1], goal[5, 0]
        result = fitted(table(turn.inv().apply(goal - SHIFT)), table(used), noise=0.01)
        assert np.abs(result.tables["points"].stacked("xyz") - goal).max() < 1e-6


def test_a_mirrored_axis_is_refused() -> None:
    x, goal = drawn(8, 2, (0.01, 0.01))
    with pytest.raises(InputError, match="mirror image of the nominal ones"):
        fitted(table(x * [1, -1, 1]), table(goal))


def test_exchanged_names_are_named() -> None:
    x, goal = drawn(8, 2, (0.01, 0.01))
    x[[2, 5]] = x[[5, 2]]
    with pytest.raises(InputError, match="points P2 and P5 are exchanged"):
        fitted(table(x), table(goal))


def test_a_moved_point_is_a_suspect() -> None:
    x, goal = drawn(10, 4, (0.0, 0.01))
    x[3] += [0.3, -0.2, 0.4]
    for measured, nominal in (
        (table(x), table(goal)),
        (table(x, sigma=np.full(10, 0.01)), table(goal, sigma=np.zeros(10))),
        (table(x, sigma=np.full(10, 0.01)), table(goal, sigma=np.full(10, 0.01))),
    ):
        result = fitted(measured, nominal, noise=0.01)
        assert result.tables["suspects"].texts("point")[0] == "P3"


def test_points_on_a_line_are_undetermined() -> None:
    x = np.linspace(0, 1, 6)[:, None] * [100.0, 50, 20]
    with pytest.raises(UndeterminedError, match="not on a line"):
        fitted(table(x), table(TURN.apply(x) + SHIFT), noise=0.01)


def test_names_that_do_not_meet_are_counted() -> None:
    x, goal = drawn(5, 1, (0.0, 0.0))
    other = table(goal)
    other.columns["point"] = np.array(["A", "B", "P2", "P3", "C"])
    with pytest.raises(UndeterminedError, match="2 points are in both lists"):
        fitted(table(x), other)


@pytest.mark.usefixtures("metrocli")
def test_four_published_pairs(metrocli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """github.com/charnley/rmsd issue 11: 0.695 mm by a rotation, 0.519 mm would be a mirror image."""
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("point,x_mm,y_mm,z_mm\n1,-1,0,0\n2,0,2,0\n3,0,1,0\n4,0,1,1\n")
    Path("b.csv").write_text("point,x_mm,y_mm,z_mm\n1,0,-1,-1\n2,0,-1,0\n3,0,0,0\n4,-1,0,0\n")
    Path("job.yaml").write_text("metrocli: 1\njob: fit-points\ninputs: {points: a.csv, nominal: b.csv}\noutput: r.h5\n")
    ran = metrocli("fit-points", "job.yaml")
    assert ran.code == 0
    assert "root mean square 0.6948 mm" in ran.out and "a mirror image would have 0.5193 mm" in ran.out
