"""What is undetermined is said in words before any number, with the view that would remove it; nothing is guessed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space
from simulated.grid import NOISE, PITCH, grid, without

from metrocli.adjust.coupled_fields import design_of
from metrocli.instruments.ball_grid import rigid
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import readings as grid_readings
from metrocli.tasks.selfcal_grid import task as selfcal_grid
from metrocli.tasks.selfcal_grid.error_map import error_at
from metrocli.tasks.selfcal_grid.problem import build
from metrocli.tasks.selfcal_grid.settings import ViewSettings, views_of

FAMILIES = {
    "123": [("fields that all rotations of the views carry into themselves", 14)],
    "124": [
        ("another scale along z", 1),
        ("planes across z bend to bowls, the wider the higher", 1),
        ("each plane across z moves by itself along z", 3),
    ],
    "134": [
        ("another scale along x", 1),
        ("a twist about x: planes across it turn in proportion to x", 1),
        ("each line along x moves by itself", 16),
    ],
    "1246": [("another scale along z", 1)],
}
REMEDIES = {
    "123": "a further view shifted by one pitch along x or shifted by one pitch along y or shifted by one pitch along z would leave 13 directions undetermined",
    "124": "a further view turned by 90 deg about x or turned by 90 deg about y would leave 13 directions undetermined",
    "134": "a further view turned by 90 deg about y or turned by 90 deg about z would leave 13 directions undetermined",
    "1246": "a further view turned by 90 deg about x or turned by 90 deg about y would leave 13 directions undetermined",
}


def run(views: str, drop: float = 0.0, **more: object):  # type: ignore[no-untyped-def]
    one = grid(5, views, seed=8)
    table = one.read(np.random.default_rng(2))
    table = without(table, np.random.default_rng(3).random(len(table)) < drop)
    return one, selfcal_grid.run(selfcal_grid.TASK.job(one.settings(leave_one_out="no", **more), table))


@pytest.mark.parametrize("views", FAMILIES)
def test_families_are_named_with_their_remedy(views: str) -> None:
    _, result = run(views)
    table = result.tables["undetermined"]
    named = list(zip(table.texts("pattern"), table.numbers("directions").astype(int).tolist(), strict=True))
    assert named[:3] == [
        ("rigid motion of the machine error", 6),
        ("rigid motion of the artefact error", 6),
        ("common scale", 1),
    ]
    assert named[3:] == FAMILIES[views]
    assert REMEDIES[views] in result.notes
    assert REMEDIES[views] in result.warnings


@pytest.mark.parametrize(("end", "left"), [((2, 2, 0), "along z"), ((0, 0, 2), "across z")])
def test_a_length_fixes_one_of_two_scales(end: tuple[int, int, int], left: str) -> None:
    """Without the turn about x the scale along z is one of its own: a length fixes that of its own direction."""
    one = grid(5, "1246", seed=8)
    columns = {f"{name}{k}": np.array([sign * end[n]]) for k, sign in ((1, -1), (2, 1)) for n, name in enumerate("ijk")}
    length = 2 * PITCH * np.linalg.norm(end)
    lengths = Table(
        {**columns, "length": np.array([length]), "sigma": np.array([1e-3])}, {"length": "mm", "sigma": "mm"}
    )
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(one.settings(leave_one_out="no"), one.read(np.random.default_rng(2)), lengths)
    )
    table = result.tables["undetermined"]
    assert table.texts("pattern")[2:] == [f"another scale {left}"]
    assert result.statistics["undetermined"] == 13


def test_four_views_say_thirteen_and_no_more() -> None:
    _, result = run("1234")
    assert result.notes[0] == (
        "13 directions undetermined: 6 rigid motions of the machine error, 6 of the artefact error, "
        "1 common scale: give one calibrated length to fix it"
    )
    assert result.warnings == ()


DETERMINED = {"123": 0.0, "124": 0.6, "134": 0.3, "1246": 0.7}
"""At least this share of the machine error's components"""


@pytest.mark.alike
@pytest.mark.parametrize("views", FAMILIES)
def test_what_is_determined_is_right_and_the_rest_is_not_given_out(views: str) -> None:
    """Components with a finite uncertainty agree with the truth but for the datum; the others are marked."""
    one, result = run(views)
    table = result.tables["machine_error"]
    std = table.stacked(["s_ex", "s_ey", "s_ez"])
    finite = np.isfinite(std)
    assert not finite.all()
    if views == "1246":
        assert np.isinf(std[one.balls[:, 2] != 0, 2]).all()
        assert finite[:, :2].all()
    if not finite.any():
        return
    error = (table.stacked(["ex", "ey", "ez"]) - one.machine)[finite]
    motions = np.concatenate([rigid(one.balls.astype(float)), one.balls[:, :, None]], axis=2)[finite]
    error = error - motions @ np.linalg.lstsq(motions, error, rcond=None)[0]
    assert np.abs(error / std[finite]).max() < 5
    assert np.sqrt(((error / std[finite]) ** 2).mean()) == pytest.approx(1.0, abs=0.25)


MOVED = {"123": set(), "124": {"4.beta", "4.x", "4.z"}, "134": {"4.x", "4.alpha"}, "1246": {"6.z"}}
"""Mountings that the families move: a view shifted along an open scale, turned with a twist or tilted with a bowl"""


@pytest.mark.alike
@pytest.mark.parametrize("views", FAMILIES)
def test_nothing_that_follows_from_what_is_open_is_given_out(views: str) -> None:
    """Between the sites, by the smooth form, as a length or as a mounting."""
    one = grid(5, views, seed=8)
    places = one.balls[::7] * PITCH
    points = Table(
        {"point": np.arange(len(places)).astype(str), **dict(zip("xyz", places.T, strict=True))},
        dict.fromkeys("xyz", "mm"),
    )
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(one.settings(leave_one_out="no"), one.read(np.random.default_rng(2)), None, points)
    )
    names = ["s_ex", "s_ey", "s_ez"]
    at_sites, mapped = result.tables["machine_error"].stacked(names)[::7], result.tables["map"].stacked(names)
    assert np.array_equal(np.isinf(at_sites), np.isinf(mapped))
    assert np.isinf(mapped).any()
    shown = error_at(result, [f"{value} mm" for value in places[0]])
    assert [np.isinf(estimate.std) for estimate in shown] == np.isinf(at_sites[0]).tolist()
    assert "length_error" not in result.tables
    assert not {"smooth/degree", "largest_length_error", "rms_machine_error"} & {*result.arrays, *result.statistics}
    assert {one.name for one in result.estimates if np.isinf(one.std)} == MOVED[views]


def test_two_views_say_what_is_open() -> None:
    """As many as are there: nothing is left when one of them is left out."""
    one = grid(3, "12", seed=8)
    result = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(), one.read(np.random.default_rng(2))))
    readings = grid_readings.read(
        views_of(one.settings()), one.settings().grid.half, one.read(np.random.default_rng(2))
    )
    problem = build(readings, (one.settings().grid.half, PITCH), NOISE)
    jacobian = design_of(problem.fields).jacobian.toarray()
    count = null_space(jacobian / np.linalg.norm(jacobian, axis=0), rcond=1e-9).shape[1]
    assert result.statistics["undetermined"] == count
    assert np.isnan(result.tables["views"].numbers("left_out_p")).all()


@pytest.mark.parametrize("shift", [(0, 0, 0), (9, 0, 0)])
def test_views_that_share_no_turn_and_no_site(shift: tuple[int, int, int]) -> None:
    """The same view again, and one beside the first: machine and artefact stay open but for their sum."""
    one = grid(3, "1", seed=8)
    table = one.read(np.random.default_rng(2))
    twice = {name: np.concatenate([values, values]) for name, values in table.columns.items()}
    twice["view"] = np.repeat(["1", "2"], len(table))
    twice["x"] = twice["x"] + np.repeat([0.0, PITCH * shift[0]], len(table))
    settings = replace(one.settings(), views=(ViewSettings("1"), ViewSettings("2", shift=shift)))
    result = selfcal_grid.run(selfcal_grid.TASK.job(settings, Table(twice, table.units)))
    # all of A, and for a view beside the first its own sites, which follow its mounting
    assert result.statistics["undetermined"] == 3 * 27 + 6 + (6 if shift[0] else 0)
    assert np.isinf(result.tables["machine_error"].numbers("s_ex")).all()


def test_a_view_of_few_balls() -> None:
    """Its turns are open, and said to be; the other views are what they are without it."""
    one = grid(3, "1234", seed=8)
    table = one.read(np.random.default_rng(2))
    fourth = np.array(table.texts("view")) == "4"
    row = (table.numbers("j") == 0) & (table.numbers("k") == 0)
    for drop, count in ((fourth & ~row, 1), (fourth & ~(row & (table.numbers("i") == 0)), 3)):
        result = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(leave_one_out="no"), without(table, drop)))
        last = result.tables["undetermined"]
        assert last.texts("pattern")[-1] == "turns of view '4', whose balls are fewer than three or in a row"
        assert last.numbers("directions")[-1] == count
    assert np.isnan(result.tables["views"].numbers("sigma0")[3])


def test_a_ball_seen_once_at_a_site_seen_once() -> None:
    """Two views by rotation about the same axis and a missing ball: a local pair is named as such."""
    one = grid(3, "1234", seed=1)
    table = one.read(np.random.default_rng(2))
    ball = (table.numbers("i") == 1) & (table.numbers("j") == 1) & (table.numbers("k") == 1)
    view = np.array(table.texts("view"))
    turned = one.balls[[tuple(b) == (1, 1, 1) for b in one.balls.tolist()]][0]
    drop = ball & (view != "1")
    for name, image in (("2", (1, -1, 1)), ("3", (1, 1, -1)), ("4", (0, 1, 1))):
        drop |= (
            (view == name)
            & (table.numbers("i") == image[0])
            & (table.numbers("j") == image[1])
            & (table.numbers("k") == image[2])
        )
    assert turned.tolist() == [1, 1, 1]
    result = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(leave_one_out="no"), without(table, drop)))
    table = result.tables["undetermined"]
    assert table.texts("pattern")[3:] == ["machine errors at sites seen once, by a ball seen once"]
    assert table.numbers("directions")[3:].tolist() == [3]
    found = result.tables["machine_error"]
    corner = (found.stacked("ijk") == 1).all(axis=1)
    std = found.stacked(["s_ex", "s_ey", "s_ez"])
    assert np.isinf(std[corner]).all()
    assert np.isfinite(std[~corner]).all()


def test_outliers_are_named_and_left_out() -> None:
    one = grid(5, seed=9)
    table = one.read(np.random.default_rng(5))
    rows = [7, 200, 430]
    for row in rows:
        table.columns["y"][row] += 40 * NOISE
    reported = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(leave_one_out="no"), table))
    names = list(
        zip(
            reported.tables["suspects"].texts("view"),
            *(reported.tables["suspects"].numbers(k).astype(int).tolist() for k in "ijk"),
            strict=True,
        )
    )
    wanted = [(table.texts("view")[row], *(int(table.numbers(k)[row]) for k in "ijk")) for row in rows]
    assert set(wanted) <= set(names)
    removed = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(leave_one_out="no", outliers="remove"), table))
    out = removed.tables["rejected"]
    gone = list(zip(out.texts("view"), *(out.numbers(k).astype(int).tolist() for k in "ijk"), strict=True))
    assert sorted(gone) == sorted(wanted)
    assert any(line.startswith("3 readings are left out as wrong: ") for line in removed.warnings)
    assert removed.statistics["sigma0"] == pytest.approx(1.0, abs=0.15)


def test_a_view_that_does_not_agree_is_told() -> None:
    """The artefact grew by 20 um/m in view 3: the other views fit without it."""
    one = grid(5, "123456", seed=10)
    table = one.read(np.random.default_rng(5))
    rows = np.array(table.texts("view")) == "3"
    for axis in "xyz":
        table.columns[axis][rows] *= 1 + 2e-5
    result = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(), table))
    told = [line for line in result.warnings if "does not agree with the others" in line]
    assert len(told) == 1
    assert told[0].startswith("view '3'")
    views = result.tables["views"]
    assert views.numbers("left_out_p")[2] < 1e-6


def test_a_view_left_out_that_does_not_converge_says_nothing() -> None:
    """Mountings off by five degrees: steps are short, and a sum of squares that is not the least would look too good."""
    one = grid(5, seed=0)
    rng = np.random.default_rng(4)
    for name in one.mountings:
        one.mountings[name] = (rng.normal(0, 0.2, 3), rng.normal(0, 0.08, 3))
    p_values = (
        selfcal_grid.run(selfcal_grid.TASK.job(one.settings(), one.read(rng))).tables["views"].numbers("left_out_p")
    )
    assert ((p_values > 1e-4) & (p_values < 1 - 1e-4) | np.isnan(p_values)).all()


def test_good_views_agree() -> None:
    one = grid(5, "123456", seed=11)
    result = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(), one.read(np.random.default_rng(6))))
    assert result.warnings == ()
    assert (result.tables["views"].numbers("left_out_p") > 1e-3).all()
