"""Location of a launch unit by each of the three methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.adjustment import adjust, covariance_at
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array
from metrocli.effects.estimates import absorbed
from metrocli.effects.requested import RequestedEffect, keys_of
from metrocli.errors import Fault, InputError, MetrocliError, NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import wrapped
from metrocli.instruments import launch_unit as lu
from metrocli.instruments.launch_start import Meeting, closed_loop, lines, set_up_angle, spread
from metrocli.tasks.locate_launch_unit.misread import misread
from metrocli.tasks.locate_launch_unit.problem import (
    STOPPING,
    WEAK,
    LaunchUnitProblem,
    SuspectedPose,
    build,
    screened,
    uncertainty_along,
    without_worst_distances,
)
from metrocli.tasks.locate_launch_unit.readings import AlignedPoses
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise
from metrocli.units import two_digits
from metrocli.words import in_a_row, listed

_APART = 10.0
"""Angle [deg] between beams from which they are no single beam, however uncertain the place is"""
_ABSURD = 100.0
"""sigma0 above this cannot come from noise"""
_NO_DISTANCE = (
    "the angles agree on a place of the unit that no distance fits: the readings do not decide whether the distances "
    "are wrong or the places of the poses; check both and their units, or leave out the distances"
)
_PASSING = 0.05
"""Angle [rad] by which the line of a beam may miss the unit, so that it is one of its beams"""
_ENOUGH = 1
"""With more poses than this, wrong columns can be recognised"""


@dataclass(frozen=True)
class How:
    """Method, treatment of outliers, and effects of a location."""

    method: str = "adjustment"
    """adjustment, lines or closed-loop"""
    remove: bool = False
    """Whether to leave outliers out"""
    effects: Sequence[RequestedEffect] = ()
    explain: bool = True
    """Whether other meanings of the columns are tried if the readings fit no place"""


@dataclass(frozen=True)
class Located:
    """A located unit."""

    values: Array
    """x y z gamma"""
    covariance: Array
    """Covariance of x y z gamma, (4, 4)"""
    readings: AlignedPoses
    problem: LaunchUnitProblem | None = None
    """The adjusted problem; None for the methods of the paper"""
    solution: Solution | None = None
    outliers: tuple[SuspectedPose, ...] = ()
    critical: float = float("nan")
    """Bound of |w| for an outlier"""
    noise: float = 1.0
    """Noise of the readings without outliers, in units of the declared one, at least 1: to it the tests refer"""

    @property
    def used(self) -> tuple[Group, ...]:
        """The groups of readings that were used; none without an adjustment."""
        if self.solution is None or self.problem is None:
            return ()
        names = {group.name for group in self.problem.groups}
        return tuple(group for group in self.solution.groups if group.name in names)

    @property
    def read(self) -> list[Residuals]:
        """The residuals of all readings that were used."""
        return [] if self.solution is None else [residuals_of(self.solution, group) for group in self.used]

    @property
    def place(self) -> Array:
        """Place of the unit, p, (3,)."""
        return self.values[:3]

    @property
    def left_out(self) -> int:
        """Number of readings that were left out as outliers."""
        if self.problem is None or self.solution is None:
            return 0
        every, used = self.problem.all_groups, self.solution.groups
        return sum(group.observations.count for group in every) - sum(group.observations.count for group in used)


def locate(readings: AlignedPoses, noise: LaunchUnitNoise, how: How | None = None) -> Located:
    """Return the located unit.

    Raises InputError if readings are impossible or fit no place, UndeterminedError if the poses do not determine the
    place, NotConvergedError if the adjustment does not converge.
    """
    how = how or How()
    try:
        located = _located(readings, noise, how)
    except MetrocliError as error:
        refusal: MetrocliError | None = error
    else:
        if located.solution is None or not located.solution.sigma0 > _ABSURD:
            return located
        refusal = None
    instead = misread(readings, noise) if how.explain and readings.names[_ENOUGH:] else ()
    if instead:
        hint = f"they would if {'; or '.join(instead)}"
        raise InputError([Fault("the readings fit no place of the unit as they stand", readings.file, hint=hint)])
    if refusal is not None:
        raise refusal
    return located


def _located(readings: AlignedPoses, noise: LaunchUnitNoise, how: How) -> Located:
    if how.effects and how.method != "adjustment":
        raise InputError(f"{keys_of(how.effects)}: only `method: adjustment` can have them in its model")
    if how.method != "adjustment" and np.isnan(readings.sigma).any():
        raise InputError(
            f"method: {how.method} takes the place of every receiver as known, and some have an empty sigma; state "
            "their sigma, or take `method: adjustment`"
        )
    _must_suffice(readings, noise, how.method)
    _refuse_mirrored(readings, noise)
    if how.method != "adjustment":
        return _as_printed(readings, noise, how.method)
    problem = build(readings, noise)
    if how.effects:
        problem = problem.with_effects(how.effects)
    solution = adjust(problem.blocks.values(), problem.all_groups, control=STOPPING)
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW:
        raise UndeterminedError(_undetermined(problem, solution), solution.misfit)
    tested, gone = solution, tuple[SuspectedPose, ...]()
    if not solution.outcome.good or solution.sigma0 > _ABSURD:
        fewer = without_worst_distances(problem, _ABSURD)
        fits = fewer is not None and not fewer[0].sigma0 > _ABSURD
        if fewer is not None and all(group.name != lu.DISTANCE for group in fewer[0].groups):
            raise NotConvergedError(_NO_DISTANCE, solution.misfit)
        if fewer is not None and fits and not how.explain:
            # a diagnosis has all readings: where the rest fits, the gross ones are far off, and nothing else
            solution = tested = covariance_at(fewer[0].blocks.values(), problem.all_groups)
        elif not solution.outcome.good and not (how.remove and fewer is not None):
            raise _contradiction(solution, fewer if fits else None)
        elif fewer is not None and (fits or not solution.outcome.good):
            # a place between the readings and the gross ones would name others
            tested, gone = fewer
    checked = screened(tested, [group.name for group in problem.groups], gone)
    used = checked.solution if how.remove else solution
    values = used.blocks[lu.UNIT].values[0].copy()
    values[3] = wrapped(values[3])
    checks = checked.outliers, checked.critical, checked.noise
    return Located(values, used.covariance_or_raise().of(lu.UNIT), readings, problem, used, *checks)


def _contradiction(solution: Solution, rest: tuple[Solution, Sequence[SuspectedPose]] | None) -> NotConvergedError:
    """Return the error of readings that have no solution, with the distances without which they have one."""
    failed, misfit = f"{solution.outcome.value} ({solution.iterations} steps)", solution.misfit
    if rest is not None:
        poses, many = in_a_row([each.pose for each in rest[1]]), len(rest[1]) > 1
        distances, them = ("distances", "them") if many else ("distance", "it")
        failed += f"; without the {distances} of {poses} the rest fits: correct {them}, or `outliers: remove`"
        misfit = rest[0].misfit  # what is left fits
    return NotConvergedError(failed, misfit)


def _undetermined(problem: LaunchUnitProblem, solution: Solution) -> str:
    """Return the message of what is undetermined: an effect that the other unknowns absorb, or the place itself."""
    hidden = absorbed(problem.effects, solution, None)
    if hidden:
        return "\n".join(
            f"{added.label} cannot be separated from the other unknowns of this job, which absorb it; "
            f"leave it out; what would separate it: {added.effect.reveal}"
            for added in hidden
        )
    reason = f"undetermined: {solution.undetermined[0]}" if solution.undetermined else solution.outcome.value
    return explained(problem.readings, reason)


def _must_suffice(readings: AlignedPoses, noise: LaunchUnitNoise, method: str) -> None:
    """Raise InputError or UndeterminedError if the poses cannot determine the place by this method."""
    measured = readings.beams.measured
    if measured.any() and noise.distance is None and method != "lines":
        raise InputError("noise: the poses have distances; add `distance: 1 um`, their standard deviation")
    if method == "closed-loop":
        if not measured.all():
            lacking = [name for name, has in zip(readings.names, measured, strict=True) if not has]
            text = f"method: closed-loop needs a distance in every pose; without one: {listed(lacking)}"
            raise UndeterminedError(f"{text}\n  what would determine it: `method: adjustment`, or those distances")
        return
    if measured.any() and method == "adjustment":
        return
    uncertain = uncertainty_along(readings, noise)
    if uncertain > WEAK:
        text = f"the distance to the unit would be uncertain by {min(uncertain, 1.0):.0%} or more"
        raise UndeterminedError(explained(readings, text, noise.encoder))


def explained(readings: AlignedPoses, words: str, encoder: float = 0.0) -> str:
    """Return the message of what is undetermined, why, and what would determine it; `encoder` is the noise [rad]."""
    n = len(readings.names)
    angle = np.rad2deg(np.arcsin(min(spread(readings.beams) / np.sqrt(n), 1.0)))
    why = "there is one pose" if n == 1 else f"all {n} poses lie on nearly one beam (within {angle:.2g} degrees)"
    why, what = f"{why}, so the unit could be anywhere along it", "a pose whose beam comes from another direction"
    if n > 1 and angle > _APART and encoder:
        noise = two_digits(float(np.rad2deg(encoder)))
        why = f"the beams are {angle:.2g} degrees apart, but each encoder angle is uncertain by {noise} degrees"
        what = "angles with less noise or more digits, and `noise: encoder` as it then is"
    return (
        f"the place of the launch unit cannot be determined: {words}\n"
        f"  why: {why}\n"
        f"  what would determine it: {what}, or a measured distance"
    )


def _refuse_mirrored(readings: AlignedPoses, noise: LaunchUnitNoise) -> None:
    """Raise InputError if a receiver points away from the place where the beams meet (the mirror solution)."""
    if uncertainty_along(readings, noise) > WEAK:
        return
    beams = readings.beams
    way = lines(beams).place - readings.receiver
    ahead = np.einsum("ni,ni->n", beams.towards, way)
    behind = ahead <= 0
    if behind.any():
        names = listed([readings.names[i] for i in np.flatnonzero(behind)])
        # reversed, a beam stays on its line: only one that passes the place of the unit is a mirrored one
        passing = -ahead[behind] > np.cos(_PASSING) * np.linalg.norm(way[behind], axis=1)
        turned = (
            "give phi3, phi4 of the direction from the receiver to the unit: reverse the sign of phi3 and turn phi4 by "
            "180 degrees"
        )
        apart = (
            "reversed, their beams would not meet the others: check the order of the rows, the columns and the units"
        )
        raise InputError(
            f"in {behind.sum()} of {len(ahead)} poses the receiver points away from the unit: {names}\n"
            f"{turned if passing.all() else apart}"
        )


def _as_printed(readings: AlignedPoses, noise: LaunchUnitNoise, method: str) -> Located:
    """Return the place by one of the methods of Kuprin et al., with the declared noise propagated to first order."""
    beams = readings.beams
    meeting = lines(beams) if method == "lines" else closed_loop(beams)
    values = np.array([*meeting.place, set_up_angle(beams)])
    return Located(values, _propagated(readings, meeting, noise), readings)


def _propagated(readings: AlignedPoses, meeting: Meeting, noise: LaunchUnitNoise) -> Array:
    """Return the covariance (4, 4) of x y z gamma.

    gamma depends on phi4 - phi1 of each pose, the place on phi4, phi3, the distance and the place of the receiver. All
    distances share the relative error of the air.
    """
    n = len(readings.names)
    share = np.full((n, 1), 1 / n)
    nothing = np.zeros((n, 3))
    encoders = np.concatenate(
        [
            np.hstack([meeting.by_base, share]),
            np.hstack([meeting.by_tilt, 0 * share]),
            np.hstack([nothing, -share]),
        ]
    )
    by_distance = np.hstack([meeting.by_distance, 0 * share])
    shared = 0.0 if readings.air is None else readings.air.std
    common = shared * np.nan_to_num(readings.distance) @ by_distance
    distances = np.vstack([by_distance * (noise.distance or 0.0), common])
    covariance = noise.encoder**2 * encoders.T @ encoders + distances.T @ distances
    receivers = meeting.by_receiver * readings.sigma[:, None, :]
    covariance[:3, :3] += np.einsum("nij,nkj->ik", receivers, receivers)
    return np.asarray(covariance)
