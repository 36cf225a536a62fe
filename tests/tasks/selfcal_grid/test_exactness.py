"""Both fields recovered to rounding, and the right number of undetermined directions for each set of views."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from simulated.grid import DECLARED, PITCH, Grid, grid, in_gauge, without

from metrocli.adjust.coupled_fields import design_of
from metrocli.instruments import ball_grid as bg
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import readings as grid_readings
from metrocli.tasks.selfcal_grid import task as selfcal_grid
from metrocli.tasks.selfcal_grid.determination.undetermined import opened
from metrocli.tasks.selfcal_grid.problem import GridProblem, build
from metrocli.tasks.selfcal_grid.settings import views_of


def problem_of(one: Grid, table: Table) -> GridProblem:
    settings = one.settings()
    readings = grid_readings.read(views_of(settings), settings.grid.half, table)
    return build(readings, (settings.grid.half, PITCH), settings.noise)


def fields(result: Result) -> tuple[np.ndarray, np.ndarray]:
    return tuple(result.tables[name].stacked(["ex", "ey", "ez"]) for name in ("machine_error", "artefact_error"))


@pytest.mark.alike
@pytest.mark.parametrize(
    ("n", "views"), [(3, "1234"), (5, "1234"), (5, "123456"), (5, "1237"), (7, "1234"), (11, "1234")]
)
def test_fields_are_recovered(n: int, views: str) -> None:
    one = grid(n, views, seed=n)
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(one.settings(leave_one_out="no"), one.read(np.random.default_rng(0), noise=0.0))
    )
    machine, artefact = fields(result)
    assert np.abs(machine - one.machine).max() < 1e-9
    assert np.abs(artefact - one.artefact).max() < 1e-9
    found = {estimate.name: estimate.value for estimate in result.estimates}
    for name, (shift, angles) in one.mountings.items():
        wanted = dict(zip(("x", "y", "z", "alpha", "beta", "gamma"), [*shift, *angles], strict=True))
        assert all(abs(found[f"{name}.{column}"] - value) < 1e-9 for column, value in wanted.items())


def test_a_rough_artefact_does_no_harm() -> None:
    """Balls off by millimetres: rank and covariance are those of a perfect artefact, the minimum is the true one."""
    one = grid(5, seed=2)
    machine, artefact = in_gauge(one.balls * PITCH, one.machine, 60 * one.artefact)
    rough = Grid(5, "1234", one.balls, machine, artefact, one.mountings)
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(rough.settings(leave_one_out="no"), rough.read(np.random.default_rng(0), noise=0.0))
    )
    assert np.abs(artefact).max() > 5
    assert all(np.abs(a - b).max() < 1e-9 for a, b in zip(fields(result), (machine, artefact), strict=True))


@pytest.mark.alike
@pytest.mark.parametrize(
    "n", [3, 5, 7, 9, 11, *(pytest.param(n, marks=pytest.mark.slow) for n in (13, 15, 17, 19, 21))]
)
def test_four_views_leave_thirteen(n: int) -> None:
    one = grid(n)
    found = design_of(problem_of(one, one.read(np.random.default_rng(0))).fields)
    assert found.null.shape[1] == 13
    assert np.abs(found.jacobian @ found.null).max() < 1e-9 * np.abs(found.jacobian).max()


COUNTS = {
    "123": lambda n: {3: 15, 5: 27, 7: 54}[n],
    "124": lambda n: 13 + n,
    "134": lambda n: 13 + 3 * (n * n - 1) // 4,
    "1246": lambda n: 14,
    "123456": lambda n: 13,
    "1237": lambda n: 13,
}


@pytest.mark.alike
@pytest.mark.parametrize("n", [3, 5, 7])
@pytest.mark.parametrize("views", COUNTS)
def test_reduced_sets_leave_what_is_known(views: str, n: int) -> None:
    one = grid(n, views)
    problem = problem_of(one, one.read(np.random.default_rng(0)))
    design = design_of(problem.fields)
    assert design.null.shape[1] == COUNTS[views](n)
    assert opened(problem, design).count == COUNTS[views](n)
    if n == 3:
        dense = design.jacobian.toarray()
        assert null_space(dense / np.linalg.norm(dense, axis=0), rcond=1e-9).shape[1] == COUNTS[views](n)


@pytest.mark.parametrize(
    ("n", "views"),
    [(3, "123"), *(pytest.param(5, one, marks=pytest.mark.slow) for one in ("123", "1234", "124", "134"))],
)
def test_uncertainties_are_those_of_dense_algebra(n: int, views: str) -> None:
    """Variances, redundancies and the datum against a pseudo-inverse followed by an S-transformation."""
    one = grid(n, views)
    table = one.read(np.random.default_rng(0))
    # missing balls: whatever symmetry a full grid has is gone
    problem = problem_of(one, without(table, np.random.default_rng(1).random(len(table)) < 0.1))
    design = design_of(problem.fields)
    dense = design.jacobian.toarray()
    normal = dense.T @ dense
    scale = 1 / np.sqrt(np.diag(normal))
    inverse = np.linalg.pinv(normal * scale[:, None] * scale, rcond=1e-11, hermitian=True) * scale[:, None] * scale
    hold = np.eye(len(normal)) - design.null @ design.constraint
    covariance = hold @ inverse @ hold.T
    for name in (bg.MACHINE, bg.ARTEFACT, bg.VIEW):
        columns = design.partition.columns[name]
        wanted = np.sqrt(np.diag(covariance))[columns[columns >= 0]]
        assert np.allclose(design.std(name)[columns >= 0], wanted, rtol=1e-7)
    redundancy = 1 - np.einsum("ij,jk,ik->i", dense, covariance, dense)
    assert np.abs(design.redundancy() - redundancy).max() < 1e-9
    held = design.constraint @ design.null
    assert np.abs(held - np.eye(len(held))).max() < 1e-6


def test_the_datum_is_the_stated_one() -> None:
    one = grid(5)
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(one.settings(leave_one_out="no"), one.read(np.random.default_rng(3)))
    )
    machine, artefact = fields(result)
    r = one.balls * PITCH
    for values in (machine, artefact):
        assert np.abs(values.sum(axis=0)).max() < 1e-9
        assert np.abs(np.cross(r, values).sum(axis=0)).max() < 1e-7
    assert abs((machine * r).sum() - (artefact * r).sum()) < 1e-7


def test_a_length_fixes_the_scale() -> None:
    """A truth with different scales of machine and artefact: without a length they are shared out, with one found."""
    one = grid(5, seed=4, scale=False)
    rng = np.random.default_rng(0)
    r = one.balls * PITCH
    stretched = Grid(5, "1234", one.balls, one.machine + 2e-5 * r, one.artefact - 3e-5 * r, one.mountings)
    table = stretched.read(rng, noise=0.0)
    ends = np.array([[-2, -2, -2, 2, 2, 2], [-2, 2, 0, 2, -2, 1]])
    place = {tuple(ball): k for k, ball in enumerate(one.balls.tolist())}
    x = r + stretched.artefact
    length = np.array([np.linalg.norm(x[place[tuple(e[:3])]] - x[place[tuple(e[3:])]]) for e in ends.tolist()])
    columns = {f"{name}{end}": ends[:, 3 * (end - 1) + n] for end in (1, 2) for n, name in enumerate("ijk")}
    lengths = Table({**columns, "length": length, "sigma": np.full(2, 1e-4)}, {"length": "mm", "sigma": "mm"})
    settings = one.settings(leave_one_out="no")
    result = selfcal_grid.run(selfcal_grid.TASK.job(settings, table, lengths))
    machine, artefact = fields(result)
    assert np.abs(machine - stretched.machine).max() < 1e-9
    assert np.abs(artefact - stretched.artefact).max() < 1e-9
    assert result.statistics["undetermined"] == 12
    assert "the scale is that of the lengths" in result.notes[0]
    free, _ = fields(selfcal_grid.run(selfcal_grid.TASK.job(settings, table)))
    share = ((stretched.machine - stretched.artefact) * r).sum() / (2 * (r * r).sum())
    assert np.abs(free - (stretched.machine - share * r)).max() < 1e-8


def test_sites_outside_the_grid_and_repeats() -> None:
    """A shifted view measured whole: its outer balls stand beyond the grid, at sites of their own."""
    one = grid(3, seed=6)
    rng = np.random.default_rng(0)
    table = one.read(rng, noise=0.0)
    outer = one.balls[one.balls[:, 0] == 1]
    shift, angles = one.mountings["4"]
    from simulated.grid import euler

    place = {tuple(ball): k for k, ball in enumerate(one.balls.tolist())}
    error = rng.normal(0, 0.01, outer.shape)
    x = PITCH * (outer + [1, 0, 0]) + one.artefact[[place[tuple(b)] for b in outer.tolist()]]
    more = error + shift + x @ euler(angles).T
    joined = {
        name: np.concatenate([table.columns[name], table.columns[name][:5], values])
        for name, values in zip(("view", *"ijk", *"xyz"), (np.array(["4"] * 9), *outer.T, *more.T), strict=True)
    }
    repeat = np.array(["1"] * len(table) + ["2"] * 5 + ["1"] * 9)
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(
            one.settings(leave_one_out="no"), Table({**joined, "repeat": repeat}, dict.fromkeys("xyz", "mm"))
        )
    )
    found = result.tables["machine_error"]
    beyond = found.numbers("i") == 2
    assert beyond.sum() == 9
    assert np.abs(found.stacked(["ex", "ey", "ez"])[~beyond] - one.machine).max() < 1e-9
    assert np.abs(found.stacked(["ex", "ey", "ez"])[beyond] - error).max() < 1e-9
    std = found.stacked(["s_ex", "s_ey", "s_ez"])
    assert (std[beyond] > 1.0 * 5e-4).all()
    # the noise gain is that of a plan and of `--compare`, at the sites of the grid
    assert result.statistics["noise_gain"] == pytest.approx(np.sqrt((std[~beyond] ** 2).mean()) / 5e-4)


@pytest.mark.parametrize("names", [("1", "2", "3", "4")])
def test_views_come_out_of_the_settings(names: tuple[str, ...]) -> None:
    from simulated.grid import SHIFTS, TURNS

    for name in names:
        view = DECLARED[name].view
        assert np.array_equal(view.turn, TURNS.get(name, np.eye(3)))
        assert np.array_equal(view.shift, SHIFTS.get(name, (0, 0, 0)))
