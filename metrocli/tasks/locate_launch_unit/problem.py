"""The adjustment of a launch unit's place, built from aligned poses, and the outliers among its readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.robust import critical_value
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.arrays import Array, Index
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.frozen import dataclass
from metrocli.instruments import launch_unit as lu
from metrocli.instruments.launch_start import nearest, set_up_angle, spread
from metrocli.tasks.locate_launch_unit.effects import AXES, PAIRS, UNITS
from metrocli.tasks.locate_launch_unit.readings import ANGLES, AlignedPoses
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise
from metrocli.tasks.shared.environment import priors_of
from metrocli.words import counted, listed

WEAK = 0.01
"""Relative uncertainty of the distance to the unit above which the beams do not determine its place"""

STOPPING = StoppingRule(limit=100)
"""Good readings take about five steps; those that contradict each other can descend along a beam for thousands"""


@dataclass(frozen=True)
class LaunchUnitProblem(Modelled):
    """A location, ready to be adjusted."""

    readings: AlignedPoses
    warnings: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[Group, ...]:
        """The groups of readings: one for each encoder, and one of distances; groups without readings are absent."""
        return self.model.readings

    @property
    def all_groups(self) -> tuple[Group, ...]:
        """The groups of readings, and the priors of receiver positions."""
        return self.model.groups


def build(readings: AlignedPoses, noise: LaunchUnitNoise) -> LaunchUnitProblem:
    """Return the adjustment; its starting value is the point nearest to all beams."""
    place, beams = nearest(readings.beams), readings.beams
    away = float(np.linalg.norm(place - readings.receiver, axis=1).mean())
    free = readings.sigma != 0
    receiver = lu.receiver_block(readings.receiver, readings.names, free, away)
    blocks = [
        lu.unit_block(place, set_up_angle(beams), away),
        receiver,
        lu.spindle_block(readings.spindle, readings.names),
    ]
    if readings.air is not None:
        blocks.append(readings.air.block)
    level, measured = np.flatnonzero(readings.level), np.flatnonzero(beams.measured)
    groups = [_angles(readings, name, level, noise.encoder) for name in lu.ENCODERS]
    if noise.distance is not None:
        groups.append(_distances(readings, measured, noise.distance))
    steep = [name for name, used in zip(readings.names, readings.level, strict=True) if not used]
    text = f"the beam is vertical in {counted(len(steep), 'pose')} without a base angle; left out are the angles of "
    read = tuple(group for group in groups if group.observations.count)
    places = {
        "encoder": Place(tuple(lu.ENCODERS)),
        "unit": Place(UNITS),
        "axis": Place(AXES),
        "pair": Place(PAIRS),
        "pose": Place(readings.names, lu.RECEIVER),
    }
    model = Model(
        {block.name: block for block in blocks},
        (*read, *priors(receiver, readings.sigma, free), *priors_of(readings.air)),
        measured=tuple(group.name for group in read),
        places=places,
        nominal={lu.RECEIVER: readings.receiver},
    )
    return LaunchUnitProblem(model, readings, (*readings.warnings, *((text + listed(steep),) if steep else ())))


def uncertainty_along(readings: AlignedPoses, noise: LaunchUnitNoise) -> float:
    """Return the relative uncertainty of the distance to the point where the beams meet, from the angles alone."""
    return noise.encoder / max(spread(readings.beams), 1e-12)


def _angles(readings: AlignedPoses, name: str, rows: Index, sigma: float) -> Group:
    """Return the group of the readings of one encoder in some of the poses."""
    tilt = readings.angles[1] if lu.ENCODERS[name][0] is Quantity.LAUNCH_ANGLES else readings.angles[2]
    values = readings.angles[ANGLES.index(name)][rows]
    observations = _observations(readings, name, rows, values, sigma)
    turned = {
        lu.TURNED.format(encoder=angle): sense[rows] for angle, sense in zip(ANGLES, readings.turned, strict=True)
    }
    conditions = {**observations.conditions, **turned, lu.OVER: (np.cos(tilt[rows]) < 0).astype(float)}
    return Group(name, lu.encoder_chain(name), replace(observations, conditions=conditions, unit="rad"))


def _distances(readings: AlignedPoses, rows: Index, sigma: float) -> Group:
    values = readings.distance[rows]
    observations = _observations(readings, lu.DISTANCE, rows, values, sigma)
    conditions = {**observations.conditions, "distance": values}
    return Group(
        lu.DISTANCE,
        lu.distance_chain(readings.air is not None),
        replace(observations, conditions=conditions, unit="mm"),
    )


def _observations(readings: AlignedPoses, name: str, rows: Index, values: Array, sigma: float) -> Observations:
    return Observations(
        values[None],
        np.array(sigma),
        {lu.RECEIVER: rows, lu.SPINDLE: rows},
        keys={"pose": tuple(readings.names[i] for i in rows), "reading": (name,) * len(rows)},
        conditions={key: value[rows] for key, value in readings.conditions.items()},
        components=(name,),
    )


_SHARE = 4
"""At most one reading in this many is called an outlier"""
_FEW = 2
"""Degrees of freedom, and readings of a group, that must remain"""


@dataclass(frozen=True)
class SuspectedPose:
    """A reading that does not fit the others."""

    group: str
    pose: str
    test: float
    """|w| relative to the noise of the other readings, which is at least the declared noise"""


@dataclass(frozen=True)
class Screened:
    """The solution without the outliers, and the outliers, the largest first."""

    solution: Solution
    outliers: tuple[SuspectedPose, ...]
    critical: float
    """Bound of |w| for an outlier"""
    noise: float
    """Noise of the readings without outliers, in units of the declared one, at least 1: to it the tests refer"""


def without_worst_distances(
    problem: LaunchUnitProblem, absurd: float
) -> tuple[Solution, tuple[SuspectedPose, ...]] | None:
    """Return a solution without the distances that are farthest off where the beams meet, and these distances.

    It is for readings with no solution, or an absurd one: a gross distance draws the place far along a beam. As few are
    left out as bring sigma0 down to `absurd`; if none do, the worst one. At most half of them are where they have to
    check each other, and up to all where the angles alone determine the place. None if there is no distance, or no
    solution without it.
    """
    distances = next((group for group in problem.groups if group.name == lu.DISTANCE), None)
    if distances is None:
        return None
    every = np.arange(distances.observations.count)
    alone = _without(problem.blocks, problem.all_groups, lu.DISTANCE, every, fewest=0)
    checked = alone is not None and not alone.sigma0 > absurd
    start = alone.blocks if alone is not None and checked else problem.blocks
    most, fewest = (len(every), 0) if checked else (max(len(every) // 2, 1), _FEW)
    off = np.abs(distances.observations.whitened(distances.residuals(start)))[0]
    order, names = np.argsort(-off), distances.observations.keys["pose"]
    first: tuple[Solution, tuple[SuspectedPose, ...]] | None = None
    for count in range(1, most + 1):
        solution = _without(start, problem.all_groups, lu.DISTANCE, order[:count], fewest)
        gone = tuple(SuspectedPose(lu.DISTANCE, names[row], float(off[row])) for row in order[:count])
        if solution is not None and not solution.sigma0 > absurd:
            return solution, gone
        first = (solution, gone) if solution is not None and count == 1 else first
    return first


def screened(solution: Solution, names: Sequence[str], gone: Sequence[SuspectedPose]) -> Screened:
    """Remove outliers from the named groups, the largest |w| first, until all pass the test at 5 % for all together.

    Each reading is tested against the noise of the others, at least the declared noise (external studentisation). A
    reading that fails only because of an outlier passes once the outlier is removed. Those `gone` are left out before.
    """
    total = sum(group.observations.count for group in solution.groups if group.name in names) + len(gone)
    critical, outliers = critical_value(total), [*gone]
    while len(outliers) < total // _SHARE and solution.dof > _FEW:
        worst, row = _worst(solution, names)
        others = max(solution.cost - worst.test**2, 0.0) / (solution.dof - 1)
        if worst.test <= critical * np.sqrt(max(others, 1.0)):
            break
        fewer = _without(solution.blocks, solution.groups, worst.group, np.array([row]))
        if fewer is None:
            break
        solution, outliers = fewer, [*outliers, worst]
    noise = float(np.sqrt(max(solution.cost / solution.dof, 1.0))) if solution.dof > 0 else 1.0
    return Screened(
        solution, tuple(replace(outlier, test=outlier.test / noise) for outlier in outliers), critical, noise
    )


def _worst(solution: Solution, names: Sequence[str]) -> tuple[SuspectedPose, int]:
    """Return the reading with the largest |w|, and its row."""
    tests = []
    for group in solution.groups:
        if group.name in names:
            w = np.abs(residuals_of(solution, group).normalised[0])
            row = int(np.argmax(w))
            tests.append((SuspectedPose(group.name, group.observations.keys["pose"][row], float(w[row])), row))
    return max(tests, key=lambda suspect: suspect[0].test)


def _without(
    blocks: Mapping[str, Block], groups: Sequence[Group], name: str, rows: Index, fewest: int = _FEW
) -> Solution | None:
    """Return the solution without some readings of a group; None if the others do not determine it, or lead nowhere."""
    left = []
    for group in groups:
        if group.name == name:
            if group.observations.count - len(rows) < fewest:
                return None
            group = group.selected(~np.isin(np.arange(group.observations.count), rows))
        left.append(group)
    solution = adjust(blocks.values(), [group for group in left if group.observations.count], control=STOPPING)
    return solution if solution.outcome.good and solution.covariance is not None else None
