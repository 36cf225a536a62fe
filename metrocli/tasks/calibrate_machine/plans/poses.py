"""Plan poses of a machine with rotary axes, and balls: what those of the job and the proposed ones will determine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.kinematics import nominal_tip
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import AXES
from metrocli.plan import Plan
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.poses import in_degrees, places_read, poses_at, problem_at, without_errors
from metrocli.tasks.calibrate_machine.plans.planned import (
    Worth,
    judged,
    planned,
    tracker_in_words,
    tracker_pose,
    worth_of,
)
from metrocli.tasks.calibrate_machine.plans.pose_program import by_set_up, program_of_poses, with_room
from metrocli.tasks.calibrate_machine.problem import MachineProblem
from metrocli.tasks.calibrate_machine.settings import LENGTHS, PROBING, STANDSTILL, Settings
from metrocli.tasks.calibrate_machine.volume import shares_spread
from metrocli.tasks.shared.lists import listed_places
from metrocli.units import roughly

_FILES = {STANDSTILL: "points.csv", LENGTHS: "lengths.csv", PROBING: "probing.csv"}
_PER_KNOT, _GROWTH, _MOST = 3, 1.4, 3000
"""Poses for each knot to begin with, how their number grows, and the largest one"""
_MANY = 4.0
"""Times as many poses leave nothing open that is open for want of poses"""
_GAIN = 0.9
"""More poses are tried as long as they reduce the ratio to this share"""
_CLOSE, _ROUNDS = 0.7, 5
"""The variance in the volume is this share of the wanted one or more, after so many rounds at most"""
_FEW = "more poses do not reduce {}: more tools, balls, reflectors or stations may"
_UNCHECKED = "collisions are not checked: leave out poses that the machine cannot reach, and plan again with the rest"
_RADIUS, _HEIGHTS = 0.15, (0.4, 1.0, 0.2)
"""Of proposed balls: distance from the axis as a share of the shortest travel, heights as shares of that distance"""


def plan_of_poses(settings: Settings, files: Files) -> Plan:
    """Return what the job's poses will determine, and propose poses, and balls if the job has none.

    Their number grows until the volume has the wanted uncertainty, or without one until the wanted ratio is reached.
    Raises UndeterminedError if no number of poses determines the volume, such as with one ball.
    """
    listed = files.poses
    proposed: dict[str, Table | str] = {}
    if settings.method == PROBING and files.balls is None:
        proposed["balls.csv"] = balls = _balls(settings)
        files = replace(files, balls=replace(balls, file="balls.csv"))
    own = []
    if listed is not None:
        own = judged(f"the poses of the job: {len(listed)}", settings, _problem(settings, listed, files))
    trial, lacks = _enough(settings, files)
    table, worth = trial.table, trial.worth
    names = {PROBING: "ball", LENGTHS: "station"}
    figures = [Estimate("readings", float(len(table)), 0.0, "1"), Estimate("uncertainty", trial.uncertainty, 0.0, "mm")]
    text = f"proposed: {len(table)} readings"
    if settings.method in names:
        n = len(set(table.texts(names[settings.method])))
        text += f" with {n} {names[settings.method]}s"
    where = []
    if settings.method == STANDSTILL:
        where = [tracker_in_words(*_reached(settings, table, files), settings.plan)]
    notes = [*own, text, *where, _UNCHECKED]
    if settings.method == LENGTHS and files.stations is None:
        stations = without_errors(settings, table, files, np.zeros(6))[1].listed_stations
        proposed |= {} if stations is None else {"stations.csv": stations}
    name = _FILES[settings.method]
    proposed |= {name: in_degrees(table), name.replace(".csv", ".nc"): program_of_poses(settings, table, files)}
    return planned(notes, figures, worth, proposed, [lacks] if lacks else [])


@dataclass(frozen=True)
class _Trial:
    """Poses and their worth."""

    table: Table
    worth: Worth

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of the error vector over the volume, of the worst tool that is measured [mm]."""
        volume = self.worth.volumetric
        if volume is None:
            raise ValueError("poses predict the volume")
        return float(volume.numbers("uncertainty")[volume.columns["measured"].astype(bool)].max())


def _enough(settings: Settings, files: Files) -> tuple[_Trial, str]:
    """Return as few poses as give the wanted uncertainty, or ratio, and what they lack of it."""
    wanted, machine = settings.plan, machine_of(settings)
    count = float(_PER_KNOT * sum(len(axis.members) for axis in machine.axes))

    def tried(count: float) -> _Trial:
        table = poses_at(settings, files, shares_spread(len(machine.axes), round(count)))
        table = by_set_up(with_room(settings, table, files))
        return _Trial(table, worth_of(settings, _problem(settings, table, files)()))

    trial, count = _first(tried, count)
    if wanted.uncertainty is None:
        while trial.worth.identified.ratio > wanted.ratio and count * _GROWTH < _MOST:
            count *= _GROWTH
            before, trial = trial, tried(count)
            if trial.worth.identified.ratio > _GAIN * before.worth.identified.ratio:
                trial = min(before, trial, key=lambda proposal: proposal.worth.identified.ratio)
                break
        ratio = trial.worth.identified.ratio
        return trial, _FEW.format(f"a ratio of {ratio:.1f} to {wanted.ratio:g}") if ratio > wanted.ratio else ""
    for _ in range(_ROUNDS):  # the variance falls with the number of poses, faster while knots have few of them
        factor = (trial.uncertainty / wanted.uncertainty) ** 2
        if _CLOSE <= factor <= 1 or (factor > 1 and count == _MOST):
            break
        count = min(count * factor * (1 + (1 - _CLOSE) / 2), _MOST)
        trial = tried(count)
    lacks = trial.uncertainty > wanted.uncertainty
    sizes = f"{roughly(trial.uncertainty, 'um')} to {roughly(wanted.uncertainty, 'um')} in the volume"
    return trial, _FEW.format(sizes) if lacks else ""


def _first(tried: Callable[[float], _Trial], count: float) -> tuple[_Trial, float]:
    """Return the fewest poses that determine the volume, and their number.

    Raises the UndeterminedError of the fewest if several times as many leave something open as well: then it is not
    their number.
    """
    try:
        return tried(count), count
    except UndeterminedError as error:
        try:
            trial = tried(count * _MANY)
        except UndeterminedError:
            raise error from None
    for more in count * _GROWTH ** np.arange(1.0, np.log(_MANY) / np.log(_GROWTH)):
        try:
            return tried(float(more)), float(more)
        except UndeterminedError:
            continue
    return trial, count * _MANY


def _problem(settings: Settings, table: Table, files: Files) -> Callable[[], MachineProblem]:
    """Return a function that builds the adjustment of poses, read on a machine without errors."""

    def problem() -> MachineProblem:
        tracker = np.zeros(6)
        if settings.method == STANDSTILL:
            tracker = tracker_pose(*_reached(settings, table, files), settings.plan)
        read, known = without_errors(settings, table, files, tracker)
        return problem_at(settings, read, known)

    return problem


def _reached(settings: Settings, table: Table, files: Files) -> tuple[Array, Array]:
    """Return the low and the high corner of the places that poses reach, (3,) mm."""
    places = places_read(settings, table, files)
    return places.min(axis=1), places.max(axis=1)


def _balls(settings: Settings) -> Table:
    """Return three balls around the axis next to the workpiece, or amid the travel, of different heights."""
    machine = machine_of(settings)
    nearest = machine.axes[machine.order[0]]
    if isinstance(nearest, RotaryAxis) and machine.bed:
        centre, along = np.array(nearest.at), nearest.number
    else:
        middle = ((machine.low + machine.high) / 2)[:, None]
        centre, along = nominal_tip(machine, middle, machine.tools[:1].T)[0][:, 0], 2
    radius = _RADIUS * min(float(np.ptp(axis.knots)) for axis in machine.axes if axis.letter in AXES)
    turns = 2 * np.pi * np.arange(len(_HEIGHTS)) / len(_HEIGHTS)
    places: Array = np.repeat(centre[None], len(_HEIGHTS), axis=0)
    places[:, (along + 1) % 3] += radius * np.cos(turns)
    places[:, (along + 2) % 3] += radius * np.sin(turns)
    places[:, along] += radius * np.array(_HEIGHTS)
    return listed_places("ball", [f"K{i + 1}" for i in range(len(places))], np.round(places, 0))
