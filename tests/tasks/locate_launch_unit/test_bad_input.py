"""Poses that cannot locate a unit, and files that do not hold what they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated.launch import NOISE, Poses, anywhere, poses, settings

from metrocli.adjust.allowance import allowance
from metrocli.doubt import doubts_of
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.tasks.locate_launch_unit import task as locate_launch_unit
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise

RNG = np.random.default_rng(32)
UNIT = np.array([300.0, 400.0, -250.0])


def on_one_beam(n: int, distances: bool = False) -> Poses:
    along = np.linspace(500, 1500, n)[:, None] * np.array([0.6, 0.64, 0.48])
    return poses(UNIT, 0.7, UNIT + along, 0.1, distances).noisy(RNG)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_poses_on_one_beam_are_refused_with_the_reason(n: int) -> None:
    with pytest.raises(
        UndeterminedError, match="what would determine it: a pose whose beam comes from another"
    ) as told:
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), on_one_beam(n).table()))
    assert told.value.exit_code == 4
    assert ("there is one pose" if n == 1 else f"all {n} poses lie on nearly one beam") in str(told.value)


def test_noise_is_the_reason_where_beams_are_apart() -> None:
    """The message blamed the layout: nearly one beam, within 26 degrees."""
    noisy = replace(settings(), noise=LaunchUnitNoise(0.05))
    with pytest.raises(UndeterminedError, match="each encoder angle is uncertain by 2.9 degrees") as refused:
        locate_launch_unit.run(locate_launch_unit.TASK.job(noisy, poses=anywhere(8, 4).table()))
    assert "what would determine it: angles with less noise" in str(refused.value)
    assert "one beam" not in str(refused.value)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_distances_save_them(n: int) -> None:
    result = locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), on_one_beam(n, distances=True).table()))
    error = [e.value - t for e, t in zip(result.estimates, [*UNIT, 0.7], strict=True)]
    assert np.all(np.abs(error) < 4.5 * np.array([e.std for e in result.estimates]))


def test_two_poses_in_different_directions_are_enough() -> None:
    result = locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), anywhere(2, 1).table()))
    assert (result.statistics["observations"], result.statistics["unknowns"], result.statistics["dof"]) == (8, 4, 4)


def test_a_receiver_of_unknown_place_is_refused() -> None:
    with pytest.raises(UndeterminedError, match="undetermined"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), anywhere(4, 1).table(sigma=np.full(4, np.nan))))


def test_closed_loop_needs_distances() -> None:
    with pytest.raises(UndeterminedError, match="needs a distance in every pose; without one: P0, P1, P2, P3"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings("closed-loop"), anywhere(4, 1).table()))


def test_distances_need_their_standard_deviation() -> None:
    with pytest.raises(InputError, match="add `distance: 1 um`"):
        locate_launch_unit.run(
            locate_launch_unit.TASK.job(settings(noise=LaunchUnitNoise(NOISE.encoder)), anywhere(4, 1, True).table())
        )


def rows(change: Callable[[np.ndarray], object]) -> Callable[[Poses], Poses]:
    def edit(given: Poses) -> Poses:
        angles = given.angles.copy()
        change(angles)
        return replace(given, angles=angles)

    return edit


def factor(value: float) -> Callable[[Poses], Poses]:
    return lambda given: replace(given, angles=given.angles * value)


def swap(i: int, j: int) -> Callable[[np.ndarray], object]:
    return lambda angles: angles.__setitem__([i, j], angles[[j, i]])


def mirrored(angles: np.ndarray) -> None:
    angles[2] *= -1
    angles[3] += np.pi


MISREAD: dict[str, tuple[Callable[[Poses], Poses], str]] = {
    "radians called degrees": (factor(np.pi / 180), "the encoder columns hold radians, not degrees"),
    "degrees called radians": (factor(180 / np.pi), "the encoder columns hold degrees, not radians"),
    "all angles in radians": (
        lambda given: replace(given, angles=given.angles * np.pi / 180, psi=given.psi * np.pi / 180),
        "the encoder columns and the spindle's hold radians, not degrees",
    ),
    "phi1 and phi4 swapped": (rows(swap(0, 3)), "the columns phi1 and phi4 are swapped"),
    "phi3 and phi4 swapped": (rows(swap(2, 3)), "the columns phi3 and phi4 are swapped"),
    "phi1 the other way round": (rows(lambda a: a.__setitem__(0, -a[0])), "phi1 count the other way round"),
    "phi4 the other way round": (rows(lambda a: a.__setitem__(3, -a[3])), "phi4 count the other way round"),
    "the mirrored unit": (rows(mirrored), r"phi3 and phi4 describe the beam as it travels.*\(the mirror solution\)"),
    "the spindle in radians": (lambda given: replace(given, psi=given.psi * np.pi / 180), "the spindle's column holds radians"),
    "z of the other sign": (lambda given: replace(given, receivers=given.receivers * [1, 1, -1]), "z has the wrong sign"),
    "the spindle the other way round": (lambda given: replace(given, psi=-given.psi), "the spindle's angle counts the other way"),
}  # fmt: skip


@pytest.mark.parametrize("distances", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", MISREAD)
def test_columns_that_hold_something_else_are_named(name: str, distances: bool) -> None:
    spoil, words = MISREAD[name]
    given = spoil(anywhere(8, 17, distances).noisy(RNG))
    with pytest.raises(InputError, match=f"(?s)fit no place of the unit as they stand.*{words}"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), given.table()))


@pytest.mark.alike
@pytest.mark.parametrize("name", ["radians called degrees", "phi1 and phi4 swapped", "the mirrored unit"])
@pytest.mark.parametrize("seed", [3, 4])
def test_two_poses_tell_as_much(name: str, seed: int) -> None:
    """Eight angles for four unknowns: four are left to tell that the columns hold something else."""
    spoil, words = MISREAD[name]
    with pytest.raises(InputError, match=f"(?s)fit no place of the unit as they stand.*{words}"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), spoil(anywhere(2, seed).noisy(RNG)).table()))


def test_one_pose_of_the_mirrored_unit_is_named() -> None:
    given = rows(lambda angles: mirrored(angles[:, 3:4]))(anywhere(8, 17).noisy(RNG))
    with pytest.raises(InputError, match=r"in 1 of 8 poses the receiver points away from the unit: P3"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), given.table()))


def test_poses_that_point_away_and_meet_nothing_are_not_called_mirrored() -> None:
    """Angles of the next pose in half of the rows: to reverse them would mend nothing."""
    given = anywhere(24, 17).noisy(RNG)
    angles = given.angles.copy()
    angles[:, 12:] = np.roll(angles[:, 12:], 1, axis=1)
    with pytest.raises(InputError, match=r"points away from the unit.*\nreversed, their beams would not meet"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), replace(given, angles=angles).table()))


def test_a_wrong_pose_is_told_and_the_result_not_recommended() -> None:
    given = anywhere(8, 17).noisy(RNG)
    receivers = given.receivers.copy()
    receivers[2] += [0.0, 30.0, 0.0]
    result = locate_launch_unit.run(
        locate_launch_unit.TASK.job(settings(), replace(given, receivers=receivers).table())
    )
    assert any("do not use this result" in line for line in doubts_of(result, ()))
    assert set(result.tables["outliers"].texts("pose")) >= {"P2"}


@pytest.mark.parametrize(("seed", "pose", "factor"), [(3, 6, 10.0), (8, 1, 0.001), (12, 0, 10.0)])
def test_one_gross_distance_is_left_out_though_nothing_converges_with_it(seed: int, pose: int, factor: float) -> None:
    given = anywhere(8, seed, distances=True).noisy(np.random.default_rng(seed))
    assert given.distance is not None
    wrong = replace(given, distance=given.distance * np.where(np.arange(8) == pose, factor, 1.0))
    with pytest.raises(NotConvergedError, match=f"without the distance of P{pose} the rest fits: correct it, or"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), wrong.table()))
    job = locate_launch_unit.TASK.job(replace(settings(), outliers="remove"), wrong.table())
    result = locate_launch_unit.run(job)
    outliers = result.tables["outliers"]
    assert (outliers.texts("pose")[0], outliers.texts("reading")[0]) == (f"P{pose}", "distance")
    assert result.statistics["rejected"] == len(outliers) and not doubts_of(result, ())


def test_two_gross_distances_of_four_are_left_out() -> None:
    """One was left out, the other spoilt the place, and the angles of all poses were named as outliers or not at all."""
    given = anywhere(8, 3, distances=True).noisy(np.random.default_rng(3))
    assert given.distance is not None
    few = np.where(np.arange(8) < 4, given.distance, np.nan)
    wrong = replace(given, distance=few + np.isin(np.arange(8), [0, 2]) * np.where(np.arange(8), 4000.0, 5200.0))
    job = locate_launch_unit.TASK.job(replace(settings(), outliers="remove"), wrong.table())
    result = locate_launch_unit.run(job)
    outliers = result.tables["outliers"]
    assert {*zip(outliers.texts("pose"), outliers.texts("reading"), strict=True)} == {
        ("P0", "distance"),
        ("P2", "distance"),
    }
    assert result.statistics["rejected"] == 2 and not doubts_of(result, ())


def test_three_gross_distances_of_four_are_named() -> None:
    """At most half were left out, though the angles of eight poses check each distance: the good one was named."""
    three = {"P0", "P1", "P2"}
    wrong = _with_gross_distances([4000.0, 4500.0, 5000.0, 0.0], seed=4)
    with pytest.raises(NotConvergedError, match="without the distances of P2, P1 and P0 the rest fits"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), wrong.table()))
    job = locate_launch_unit.TASK.job(replace(settings(), outliers="remove"), wrong.table())
    result = locate_launch_unit.run(job)
    assert set(result.tables["outliers"].texts("pose")) == three
    assert result.statistics["rejected"] == 3 and not doubts_of(result, ())
    wrong = _with_gross_distances([4000.0, 4500.0, 5000.0, 0.0], seed=7)
    absurd = locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), wrong.table()))
    assert set(absurd.tables["outliers"].texts("pose")) == three and doubts_of(absurd, ())


@pytest.mark.parametrize("outliers", ["report", "remove"])
def test_distances_none_of_which_fits_the_angles_are_not_decided(outliers: str) -> None:
    """The place was metres off between angles and distances, and two of the four were named as wrong."""
    wrong = _with_gross_distances([4000.0, 3000.0, 5000.0, 2500.0], seed=3)
    job = locate_launch_unit.TASK.job(replace(settings(), outliers=outliers), wrong.table())
    # a diagnosis named all four as wrong, and that the job could leave them out
    for answer in (locate_launch_unit.run, locate_launch_unit.diagnosed):
        with pytest.raises(NotConvergedError, match="no distance fits: the readings do not decide"):
            answer(job)


def _with_gross_distances(off: list[float], seed: int) -> Poses:
    """Return eight poses, of which as many have a distance as `off` has errors of one."""
    given = anywhere(8, seed, distances=True).noisy(np.random.default_rng(seed))
    assert given.distance is not None
    errors = np.pad(np.array(off), (0, 8 - len(off)), constant_values=np.nan)
    return replace(given, distance=given.distance + errors)


@pytest.mark.parametrize(("outliers", "advised"), [("report", True), ("remove", False)])
def test_a_job_that_leaves_outliers_out_is_not_advised_to(outliers: str, advised: bool) -> None:
    given = anywhere(8, 17).noisy(np.random.default_rng(17))
    angles = given.angles + 1e-3 * np.random.default_rng(1).normal(size=given.angles.shape)
    angles[0, 2] += 0.5
    job = locate_launch_unit.TASK.job(replace(settings(), outliers=outliers), replace(given, angles=angles).table())
    (absurd,) = (text for text in locate_launch_unit.run(job).warnings if "does not fit the readings" in text)
    assert ("`outliers: remove`" in absurd) == advised


@pytest.mark.parametrize("seed", [6, 9])
def test_distances_in_metres_end_in_few_steps(seed: int) -> None:
    """They and the angles contradict each other, and the place descends along a beam: more steps decide nothing."""
    given = anywhere(8, seed, distances=True).noisy(np.random.default_rng(seed))
    assert given.distance is not None
    job = locate_launch_unit.TASK.job(settings(), replace(given, distance=given.distance / 1000).table())
    with allowance(900), pytest.raises(NotConvergedError, match="check both and their units"):
        locate_launch_unit.run(job)


def test_repeated_rows_are_told() -> None:
    given = anywhere(5, 17).noisy(RNG)
    twice = replace(
        given,
        receivers=np.vstack([given.receivers, given.receivers[1:2]]),
        psi=np.append(given.psi, given.psi[1]),
        angles=np.hstack([given.angles, given.angles[:, 1:2]]),
    )
    result = locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), twice.table()))
    assert any("count as if measured twice: P1, P5" in line for line in result.warnings)


def test_no_poses_and_distances_that_are_none() -> None:
    with pytest.raises(InputError, match="there are no poses"):
        locate_launch_unit.run(
            locate_launch_unit.TASK.job(
                settings(),
                replace(anywhere(3, 1), receivers=np.zeros((0, 3)), psi=np.zeros(0), angles=np.zeros((4, 0))).table(),
            )
        )
    given = anywhere(3, 1, True)
    assert given.distance is not None
    given.distance[1] = -5.0
    with pytest.raises(InputError, match=r"poses.csv:3: error: pose P1: the distance is not above zero"):
        locate_launch_unit.run(locate_launch_unit.TASK.job(settings(), given.table()))
