"""The adjustment of image points, from a robust start, with removal of outliers and estimation of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.clusters.robust import Clusters
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import Fit, Suspects, apart, gross, robust_start, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.errors import InputError, NotConvergedError
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.shared.structured_noise import Structured, structured

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
_LEAST = 1e-7
"""Smallest noise [px] that is estimated: below it the residuals are rounding errors"""
_ROUNDS = 60
"""Limit of the rounds; the noise settles slowly if priors of the targets are as wide as the targets themselves"""


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
class Adjusted:
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

    def with_structure(self, delivered: Sequence[str]) -> Adjusted:
        """Return the adjustment with the covariance that lets readings of one image share errors.

        `delivered` are the blocks of the estimates. Raises as `cluster_robust` does.
        """
        # a list of targets that is estimated too, and seen in all images, is not part of the lens
        first = tuple(name for name in delivered if len(self.solution.blocks[name].members) == 1)
        clusters = Clusters({self.group.name: self.group.observations.index["view"]}, "images", first=first)
        found, solution = structured(self.solution, clusters, delivered)
        return replace(self, solution=solution, structured=found)


@dataclass(frozen=True)
class _Settled:
    """A solution whose noise, if it is estimated, agrees with its residuals."""

    solution: Solution
    group: Group
    residuals: Residuals | None

    def suspects(self, noise_known: bool) -> Suspects:
        if self.residuals is None:
            return Suspects(np.zeros(0, dtype=np.intp), np.zeros(0), 0.0)
        return suspects(self.residuals, Fit(self.solution.cost, self.solution.dof, noise_known))

    def apart(self, found: Suspects) -> Index:
        """Return the places of the suspects that can be removed together."""
        if self.residuals is None:
            return np.zeros(0, dtype=np.intp)
        return apart(found, self.residuals, self.group.observations.index["view"])


def adjust_images(
    blocks: Mapping[str, Block], group: Group, others: Sequence[Group], datum: Datum | None, options: Options
) -> Adjusted:
    """Adjust image points from a robust start; remove outliers and estimate the noise as the options ask.

    Gross errors are removed before the first adjustment. Then the outliers whose tests do not depend on each other are
    removed and the rest adjusted again, until no reading exceeds the bound: roughly first, at the end exactly. Raises
    InputError if most readings are far from any solution.
    """
    state: Mapping[str, Block] = blocks
    if not options.started:
        state = robust_start(blocks.values(), [group, *others], group.name, datum, "view")
    far = gross(group, state) if options.remove_outliers else np.zeros(group.observations.count)
    rows, tests = np.flatnonzero(far == 0), far
    used = group.selected(rows)
    within = _ROUGH if options.remove_outliers else _EXACT
    while True:
        settled = _settled(state, used, others, datum, options.estimate_noise, within)
        found = settled.suspects(not options.estimate_noise)
        out = settled.apart(found) if options.remove_outliers else found.rows[:0]
        if not out.size and within is _EXACT:
            break
        if not out.size:
            within = _EXACT
        keep = np.ones(len(rows), dtype=bool)
        keep[found.rows[out]] = False
        tests[rows[~keep]] = found.tests[out]
        rows, used, state = rows[keep], settled.group.selected(keep), settled.solution.blocks
    if settled.solution.outcome.good:
        _must_fit(settled.residuals, options.image_size)
    noise = float(np.sqrt(np.mean(settled.group.observations.sigma**2))) if options.estimate_noise else None
    return Adjusted(settled.solution, settled.group, settled.residuals, _rejected(group, tests), found, noise)


def _must_fit(residuals: Residuals | None, image_size: tuple[int, int]) -> None:
    """Raise InputError if the median residual is far too large: a mistake in the files, not noise."""
    middle = float("inf") if residuals is None else float(np.median(np.sqrt((residuals.values**2).sum(axis=0))))
    if image_size[0] and np.isfinite(middle) and middle > _LOST * max(image_size):
        raise InputError(
            f"the readings fit no pose. Half of them are off by more than {middle:.0f} px. Check the names of the "
            "targets, the units (mm or m, rad or deg), exchanged or mirrored axes, the camera file and the poses. If "
            "there are few readings, one gross error may be the cause: `outliers: remove`"
        )


def _settled(
    state: Mapping[str, Block],
    group: Group,
    others: Sequence[Group],
    datum: Datum | None,
    estimate_noise: bool,
    within: Within,
) -> _Settled:
    """Adjust; if the noise is estimated, repeat with the noise of the last round until it no longer changes."""
    for _ in range(_ROUNDS):
        solution = adjust(state.values(), [group, *others], datum, Control(tolerance=within.step))
        if not solution.outcome.good:
            return _Settled(solution, group, None)
        found = residuals_of(solution, group)
        noise = _noise(found, group) if estimate_noise else 1.0
        sigma = np.maximum(group.observations.sigma * noise, _LEAST)
        if abs(noise - 1) <= within.noise or (group.observations.sigma <= _LEAST).any():
            break
        group = group.with_observations(replace(group.observations, sigma=sigma))
        state = solution.blocks
    return _Settled(solution, group, found)


def must_converge(solution: Solution, noticed: Sequence[str] = ()) -> None:
    """Raise NotConvergedError unless the solution is good or undetermined (the task explains the latter).

    `noticed` are causes that the task sees.
    """
    if not solution.outcome.good and not solution.undetermined:
        hint = _NO_START if solution.outcome is Outcome.NO_START and not noticed else ""
        hint += "".join(f"\n  noticed: {line}" for line in noticed)
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps){hint}", solution.misfit)


def _noise(found: Residuals, group: Group) -> float:
    """Return sigma0 of the image points alone, `sqrt(v'Pv / sum r)` with redundancy numbers r (variance component)."""
    whitened = group.observations.whitened(found.values)
    controlled = float(found.redundancy.sum())
    return float(np.sqrt((whitened**2).sum() / controlled)) if controlled > 0 else 1.0


def _rejected(group: Group, tests: Array) -> Table:
    """Return the table `rejected` of the readings left out, from the test value w of each reading (n,), 0 if used."""
    rows = np.flatnonzero(tests)
    keys = group.observations.keys
    return Table(
        {
            "image": np.array([keys["image"][i] for i in rows], dtype=str),
            "target": np.array([keys["target"][i] for i in rows], dtype=str),
            "u": group.observations.readings[0, rows],
            "v": group.observations.readings[1, rows],
            "w": tests[rows],
        },
        {"u": "px", "v": "px"},
    )
