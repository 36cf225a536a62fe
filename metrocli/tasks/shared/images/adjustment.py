"""The adjustment of image points, from a robust start, with removal of outliers and estimation of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.robust import Fit, Suspects, gross, robust_start, suspects, typical
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.errors import InputError, NotConvergedError
from metrocli.table import Table

IMAGES = "images"
"""Name of the group of image points"""


_NO_START = (
    "\n  check that image points and targets belong together (names, order, units), "
    "and that image_size and the poses are right"
)
_SETTLED = 1e-7
"""The noise estimate has converged when a round changes it by less than this share"""
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

    def known_residuals(self) -> Residuals:
        """Return the residuals; raises RuntimeError if there is no good solution (check the outcome first)."""
        if self.residuals is None:
            raise RuntimeError(self.solution.outcome.value)
        return self.residuals


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


def adjust_images(
    blocks: Mapping[str, Block], group: Group, others: Sequence[Group], datum: Datum | None, options: Options
) -> Adjusted:
    """Adjust image points from a robust start; remove outliers and estimate the noise as the options ask.

    Gross errors are removed before the first adjustment. Then the worst outlier of each image is removed and the rest
    adjusted again, until no reading exceeds the bound. Raises InputError if most readings are far from any solution.
    """
    state = robust_start(blocks.values(), [group, *others], group.name, datum, "view")
    far = gross(group, state) if options.remove_outliers else np.zeros(group.observations.count)
    dropped = [(int(i), float(far[i])) for i in np.flatnonzero(far)]
    rows = np.flatnonzero(far == 0)
    used = group if not dropped else group.selected(rows)
    while True:
        settled = _settled(state, used, others, datum, options.estimate_noise)
        found = settled.suspects(not options.estimate_noise)
        worst = _worst_of_each_image(found, settled.group) if options.remove_outliers else []
        if not worst:
            break
        dropped += [(int(rows[i]), test) for i, test in worst]
        keep = np.ones(len(rows), dtype=bool)
        keep[[i for i, _ in worst]] = False
        rows, used, state = rows[keep], settled.group.selected(keep), dict(settled.solution.blocks)
    if settled.solution.outcome.good:
        _must_fit(settled.group, settled.solution.blocks, options.image_size)
    noise = float(np.sqrt(np.mean(settled.group.observations.sigma**2))) if options.estimate_noise else None
    rejected = _rejected(group, dropped)
    return Adjusted(settled.solution, settled.group, settled.residuals, rejected, found, noise)


def _must_fit(group: Group, blocks: Mapping[str, Block], image_size: tuple[int, int]) -> None:
    """Raise InputError if the median residual is far too large: a mistake in the files, not noise."""
    middle = typical(group, blocks)
    if image_size[0] and np.isfinite(middle) and middle > _LOST * max(image_size):
        raise InputError(
            f"the readings fit no pose. Half of them are off by more than {middle:.0f} px. Check the names of the "
            "targets, the units (mm or m, rad or deg), exchanged or mirrored axes, the camera file and the poses. If "
            "there are few readings, one gross error may be the cause: `outliers: remove`"
        )


def _settled(
    state: Mapping[str, Block], group: Group, others: Sequence[Group], datum: Datum | None, estimate_noise: bool
) -> _Settled:
    """Adjust; if the noise is estimated, repeat with the noise of the last round until it no longer changes."""
    for _ in range(_ROUNDS):
        solution = adjust(state.values(), [group, *others], datum)
        if not solution.outcome.good:
            return _Settled(solution, group, None)
        found = residuals_of(solution, group)
        noise = _noise(found, group) if estimate_noise else 1.0
        sigma = np.maximum(group.observations.sigma * noise, _LEAST)
        if abs(noise - 1) <= _SETTLED or (group.observations.sigma <= _LEAST).any():
            break
        group = group.with_observations(replace(group.observations, sigma=sigma))
        state = solution.blocks
    return _Settled(solution, group, found)


def must_converge(solution: Solution) -> None:
    """Raise NotConvergedError unless the solution is good or undetermined (the task explains the latter)."""
    if not solution.outcome.good and not solution.undetermined:
        hint = _NO_START if solution.outcome is Outcome.NO_START else ""
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps){hint}")


def _noise(found: Residuals, group: Group) -> float:
    """Return sigma0 of the image points alone, `sqrt(v'Pv / sum r)` with redundancy numbers r (variance component)."""
    whitened = group.observations.whitened(found.values)
    controlled = float(found.redundancy.sum())
    return float(np.sqrt((whitened**2).sum() / controlled)) if controlled > 0 else 1.0


def _worst_of_each_image(found: Suspects, group: Group) -> list[tuple[int, float]]:
    """Return row and test value of the worst suspect in each image: one outlier makes its neighbours suspect too."""
    views = group.observations.index["view"].tolist()
    worst: dict[int, tuple[int, float]] = {}
    for row, test in zip(found.rows.tolist(), found.tests.tolist(), strict=True):
        if test > worst.get(views[row], (0, 0.0))[1]:
            worst[views[row]] = (row, test)
    return list(worst.values())


def _rejected(group: Group, dropped: Sequence[tuple[int, float]]) -> Table:
    """Return the table `rejected` of the dropped readings, with the test value w of each."""
    rows = [row for row, _ in dropped]
    keys = group.observations.keys
    return Table(
        {
            "image": np.array([keys["image"][i] for i in rows], dtype=str),
            "target": np.array([keys["target"][i] for i in rows], dtype=str),
            "u": group.observations.readings[0, rows],
            "v": group.observations.readings[1, rows],
            "w": np.array([test for _, test in dropped], dtype=float),
        },
        {"u": "px", "v": "px"},
    )
