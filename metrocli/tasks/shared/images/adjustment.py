"""The adjustment of image points, from a robust start, with removal of outliers and estimation of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.clusters.robust import STRUCTURED, Clusters
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import (
    FitQuality,
    Suspects,
    apart,
    fitting,
    gross,
    robust_start,
    suspects,
    typical,
    worst_member,
)
from metrocli.adjust.rounds import Used, in_rounds
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array
from metrocli.errors import InputError, NotConvergedError
from metrocli.frozen import dataclass
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.tasks.shared.images.lost import lost_targets, rejected, without_lost_views, without_targets
from metrocli.tasks.shared.noise import Structured, job_noise

IMAGES = "images"
"""Name of the group of image points"""


@dataclass(frozen=True)
class Within:
    """When an adjustment with estimated noise has converged."""

    step: float
    """Length of the last step, in standard deviations of the unknowns"""
    noise: float
    """Largest change of the noise by a round, as a share of it"""


_NO_START = (
    "\n  check that image points and targets belong together (names, order, units), "
    "and that image_size and the poses are right"
)
_EXACT = Within(1e-6, 1e-7)
_ROUGH = Within(0.03, 0.03)
"""Near enough to find outliers: it changes no test by more than this"""
_LOST = 0.01
"""A median residual above this share of the image size means a mistake in the files"""
_LOST_STEPS = 40
"""Steps after which an adjustment ends whose median residual is above that share still, as it was at the start"""
_LEAST = 1e-7
"""Smallest noise [px] that is estimated: below it the residuals are rounding errors"""
_MOST = 1000
"""Limit of the rounds in which outliers are removed"""
_AGAIN = 5
"""Limit of the times that readings come back which fit without those that were left out after them"""
_ROUNDS = 60
"""Limit of the rounds in which the noise is estimated; it settles slowly if priors of targets are as wide as these"""


@dataclass(frozen=True)
class Options:
    """How outliers and noise are treated."""

    remove_outliers: bool = False
    estimate_noise: bool = False
    image_size: tuple[int, int] = (0, 0)
    """Width and height [px], the scale for residuals that reveal a mistake in the files; (0, 0): not checked"""
    started: bool = False
    """Whether the blocks come from a robust start of the same readings and unknowns"""


@dataclass(frozen=True)
class AdjustedImages:
    """An adjustment of image points, with the readings that were rejected."""

    solution: Solution
    group: Group
    """The image points that were used"""
    residuals: Residuals | None
    """None if the adjustment has no good solution"""
    rejected: Table
    """Readings left out as outliers, with their test value w"""
    suspects: Suspects
    """Readings still in use that exceed the outlier bound"""
    noise: float | None = None
    """Standard deviation of an image coordinate [px], estimated from the residuals; None if it was declared"""
    structured: Structured | None = None
    """What readings of one image share, if the job lets them; the covariance of `solution` then counts it"""

    def known_residuals(self) -> Residuals:
        """Return the residuals; raises RuntimeError if there is no good solution (check the outcome first)."""
        if self.residuals is None:
            raise RuntimeError(self.solution.outcome.value)
        return self.residuals

    def details(self, names: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return what is known of each estimate besides its uncertainty."""
        return self.structured.details(names) if self.structured is not None else {}

    def with_structure(self, delivered: Sequence[str]) -> AdjustedImages:
        """Return the adjustment with the covariance that lets readings of one image share errors.

        `delivered` are the blocks of the estimates. Raises as `cluster_robust` does.
        """
        # a list of targets that is estimated too, and seen in all images, is not part of the lens
        first = tuple(name for name in delivered if len(self.solution.blocks[name].members) == 1)
        clusters = Clusters({self.group.name: self.group.observations.index["view"]}, "images", first=first)
        noise = job_noise((self.solution, 1.0), STRUCTURED, lambda: clusters, delivered)
        return replace(self, solution=noise.solution, structured=noise.structured)


@dataclass(frozen=True)
class _KeptImagePoints:
    """The image points in use, with their noise, at values to start from."""

    used: Used
    group: Group
    state: Mapping[str, Block]
    within: Within


@dataclass(frozen=True)
class _Solved:
    """A solution, and its residuals where it is good."""

    solution: Solution
    group: Group
    residuals: Residuals | None

    def suspects(self, noise_known: bool) -> Suspects:
        if self.residuals is None:
            return Suspects(np.zeros(0, dtype=np.intp), np.zeros(0), 0.0)
        return suspects(self.residuals, FitQuality(self.solution.cost, self.solution.dof, noise_known))


def adjust_images(
    blocks: Mapping[str, Block], group: Group, others: Sequence[Group], datum: Datum | None, options: Options
) -> AdjustedImages:
    """Adjust image points from a robust start; remove outliers and estimate the noise as the options ask.

    A target that loses so many readings that the others do not place it is left out with them. Raises InputError if
    most readings are far from any solution.
    """
    found = _adjusted(blocks, group, others, datum, options)
    if found.solution.outcome.good or not options.remove_outliers or TARGET not in blocks:
        return found
    lost = lost_targets(blocks[TARGET], group, found.group, others)
    if not lost.any():
        return found
    fewer, rest, kept = without_targets(lost, blocks, group, datum)
    without = adjust_images(fewer, rest, others, kept, options)
    if not without.solution.outcome.good:
        return found
    tests = np.where(lost[group.observations.index[TARGET]], np.nan, 0.0)
    return replace(without, rejected=Table.stack([without.rejected, rejected(group, tests)]))


def _adjusted(
    blocks: Mapping[str, Block], group: Group, others: Sequence[Group], datum: Datum | None, options: Options
) -> AdjustedImages:
    """Adjust image points as `adjust_images`, with all targets.

    Gross errors are removed before the first adjustment. Then the outliers whose tests do not depend on each other are
    removed and the rest adjusted again, until no reading exceeds the bound: roughly first, at the end exactly. Raises
    InputError if most readings are far from any solution.
    """
    state: Mapping[str, Block] = blocks
    if not options.started:
        state = robust_start(blocks.values(), [group, *others], (group.name,), datum, "view")
    # readings that are far off at the start are left out at once: each would otherwise take a round of its own
    far = gross(group, state) if options.remove_outliers else np.zeros(group.observations.count)

    def begun(tests: Array, state: Mapping[str, Block]) -> _KeptImagePoints:
        kept = group.selected(np.flatnonzero(tests == 0))
        return _KeptImagePoints(
            Used(tests), kept, without_lost_views(state, kept), _ROUGH if options.remove_outliers else _EXACT
        )

    def fewer(using: _KeptImagePoints, solved: _Solved) -> tuple[_KeptImagePoints, bool]:
        suspected = solved.suspects(not options.estimate_noise)
        out = np.zeros(0, dtype=np.intp)
        if options.remove_outliers and solved.residuals is not None:
            out = apart(suspected, solved.residuals, solved.group.observations.index["view"])
        keep = np.ones(solved.group.observations.count, dtype=bool)
        keep[suspected.rows[out]] = False
        rest = solved.group.selected(keep)
        left = _KeptImagePoints(
            using.used.without(suspected, out),
            rest,
            without_lost_views(solved.solution.blocks, rest),
            # rough as long as outliers are found; a last adjustment is exact
            using.within if out.size else _EXACT,
        )
        return left, bool(out.size) or using.within is not _EXACT

    def solve(using: _KeptImagePoints) -> _Solved:
        return _solved(using, others, datum, options)

    using, solved = in_rounds(begun(far, state), solve, fewer, _MOST)
    if options.remove_outliers and not solved.solution.outcome.good:
        # an image of another lens took targets along, whose readings in other images have left: they fit without it
        foreign = worst_member(group, state, "view")
        without = in_rounds(begun(foreign, state), solve, fewer, _MOST) if foreign.any() else (using, solved)
        using, solved = without if without[1].solution.outcome.good else (using, solved)
    for _ in range(_AGAIN if options.remove_outliers else 0):
        if not solved.solution.outcome.good:
            break
        # a foreign image raises the tests of the others, until it has left: what fits without it comes back
        found = {name: block.with_values(solved.solution.blocks[name].values) for name, block in blocks.items()}
        tests = np.where(fitting(group, found), 0.0, using.used.tests)
        if np.count_nonzero(tests) == len(using.used.rejected):
            break
        again, better = in_rounds(begun(tests, found), solve, fewer, _MOST)
        if not better.solution.outcome.good or len(again.used.rejected) >= len(using.used.rejected):
            break
        using, solved = again, better
    if solved.solution.outcome.good:
        must_fit(typical(solved.group, solved.solution.blocks), options.image_size)
    noise = float(np.sqrt(np.mean(solved.group.observations.sigma**2))) if options.estimate_noise else None
    suspected = solved.suspects(not options.estimate_noise)
    out = rejected(group, using.used.tests)
    return AdjustedImages(solved.solution, solved.group, solved.residuals, out, suspected, noise)


def is_lost(middle: float, image_size: tuple[int, int]) -> bool:
    """Return whether a median residual [px] is far too large for an image, if its size is known."""
    return image_size[0] > 0 and bool(np.isfinite(middle)) and middle > _LOST * max(image_size)


def must_fit(middle: float, image_size: tuple[int, int]) -> None:
    """Raise InputError if the median residual [px] is far too large: a mistake in the files, not noise."""
    if is_lost(middle, image_size):
        raise InputError(
            f"the readings fit no pose. Half of them are off by more than {middle:.0f} px. Check the names of the "
            "targets, the units (mm or m, rad or deg), exchanged or mirrored axes, the camera file and the poses. If "
            "there are few readings, one gross error may be the cause: `outliers: remove`"
        )


def _solved(using: _KeptImagePoints, others: Sequence[Group], datum: Datum | None, options: Options) -> _Solved:
    """Adjust; if the noise is estimated, repeat with the noise of the last round until it no longer changes."""

    def solve(here: tuple[Group, Mapping[str, Block]]) -> _Solved:
        group, state = here
        rule, groups = StoppingRule(tolerance=using.within.step), [group, *others]
        if is_lost(typical(group, state), options.image_size):
            # readings that fit nothing would wander for a thousand steps
            solution = adjust(state.values(), groups, datum, replace(rule, limit=_LOST_STEPS))
            state = solution.blocks
            if solution.outcome.good or is_lost(typical(group, state), options.image_size):
                return _Solved(solution, group, residuals_of(solution, group) if solution.outcome.good else None)
        solution = adjust(state.values(), groups, datum, rule)
        return _Solved(solution, group, residuals_of(solution, group) if solution.outcome.good else None)

    def renewed(
        here: tuple[Group, Mapping[str, Block]], solved: _Solved
    ) -> tuple[tuple[Group, Mapping[str, Block]], bool]:
        sigma = solved.group.observations.sigma
        if solved.residuals is None or not options.estimate_noise or (sigma <= _LEAST).any():
            return here, False
        noise = _noise(solved.residuals, solved.group)
        if abs(noise - 1) <= using.within.noise:
            return here, False
        observations = replace(solved.group.observations, sigma=np.maximum(sigma * noise, _LEAST))
        return (solved.group.with_observations(observations), solved.solution.blocks), True

    return in_rounds((using.group, using.state), solve, renewed, _ROUNDS)[1]


def must_converge(solution: Solution, noticed: Sequence[str] = ()) -> None:
    """Raise NotConvergedError unless the solution is good or undetermined (the task explains the latter).

    `noticed` are causes that the task sees.
    """
    if not solution.outcome.good and not solution.undetermined:
        hint = _NO_START if solution.outcome is Outcome.NO_START and not noticed else ""
        hint += "".join(f"\n  noticed: {line}" for line in noticed)
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps){hint}", solution.misfit)


def _noise(residuals: Residuals, group: Group) -> float:
    """Return sigma0 of the image points alone, `sqrt(v'Pv / sum r)` with redundancy numbers r (variance component)."""
    whitened = group.observations.whitened(residuals.values)
    # the image points alone: lists and priors beside them have a noise of their own
    controlled = float(residuals.redundancy.sum())
    return float(np.sqrt((whitened**2).sum() / controlled)) if controlled > 0 else 1.0
