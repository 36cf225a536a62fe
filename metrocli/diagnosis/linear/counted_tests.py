"""Score tests of a job's candidates, with the effective numbers of tests from simulated white noise.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.candidates import Family
from metrocli.diagnosis.linear.columns import Columns
from metrocli.diagnosis.linear.distributions import log_family, log_tail
from metrocli.diagnosis.linear.fitted_columns import PRIOR, orthonormal
from metrocli.diagnosis.linear.projection import VISIBLE, System
from metrocli.diagnosis.linear.quadratics import ranks_of, roots
from metrocli.diagnosis.linear.score_tests import ScoreTests

_DRAWS = 1000
_MOST_WORK = 4e9
_MOST_AT_ONCE = 4_000_000
"""Largest number of elements of the noise that is drawn at once"""
_SAMPLE = 12_000
"""Rows of the local members whose noise is drawn, if a measurement has more than twice as many"""
_LOST = 0.05
"""Largest share of the candidates that these members may not show"""
_REDUNDANT = 1e-3
"""Smallest redundancy of a reading that can be named an outlier"""


def score_tests_of(
    system: System,
    families: Sequence[Family],
    rng: np.random.Generator,
    apart: bool = False,
    like: ScoreTests | None = None,
) -> ScoreTests:
    """Return the tests of families and outliers, with effective numbers of tests from simulated white noise.

    With `apart` each component of a reading is tested on its own. Tests `like` these, of the same families about other
    values of the unknowns or with other weights, give the effective numbers without a simulation.
    """
    places = _places(system)
    places = places[places >= 0][:, None] if apart else places
    test_set = _with_readings(system, families, places)
    counted = None if like is None else test_set.counted_as(like)
    return _calibrated(test_set, rng) if counted is None else counted


def _with_readings(system: System, families: Sequence[Family], places: Index) -> ScoreTests:
    """Return uncounted tests of families and of single readings, whose rows are `places` (readings, d)."""
    there = (places >= 0).astype(float)
    blocks = np.eye(places.shape[1]) * there[:, :, None] - system.basis.products(places, places)
    weak = np.einsum("iaa->ia", blocks).sum(axis=1) < _REDUNDANT
    return ScoreTests(system, tuple(families), blocks, places, excluded=weak)


def _places(system: System) -> Index:
    """Return the rows of each reading of the measured groups, (readings, d), -1 if it has fewer components."""
    groups = system.model.readings
    most = max(len(group.observations.readings) for group in groups)
    parts = []
    for group in groups:
        d, n = group.observations.readings.shape
        rows = np.full((n, most), -1, dtype=np.intp)
        rows[:, :d] = system.first[group.name] + d * np.arange(n)[:, None] + np.arange(d)
        parts.append(rows)
    return np.concatenate(parts)


def _smallest(test_set: ScoreTests, rng: np.random.Generator, draws: int) -> list[Array]:
    """Return ln of the smallest p-value in draws of white noise, (draws,), of each family, then of the outliers."""
    system = test_set.system
    noise = system.seen(rng.normal(size=(system.rows, draws)))
    # the declared noise counts as PRIOR degrees of freedom, in the draws as in the residuals
    squares = (noise**2).sum(axis=0) + rng.chisquare(PRIOR, draws)
    dof = system.dof + PRIOR
    least = [
        smallest_of_family(family.columns, family.gram, family.raw, noise, squares, dof) for family in test_set.families
    ]
    rows = test_set.places
    right = np.where((rows >= 0)[:, :, None], noise[rows], 0.0)
    least.append(smallest_in_noise(test_set.blocks, right, np.ones(rows.shape), squares, dof, ~test_set.excluded))
    return least


def _calibrated(test_set: ScoreTests, rng: np.random.Generator) -> ScoreTests:
    drawn = _of_some_members(test_set, rng) or test_set
    system = drawn.system
    columns = sum(f.columns.count * f.columns.parameters for f in drawn.families)
    draws = int(np.clip(_MOST_WORK / (system.rows * max(columns, 1)), 300, _DRAWS))
    together = int(np.clip(_MOST_AT_ONCE // system.rows, 1, draws))
    parts = [_smallest(drawn, rng, min(together, draws - start)) for start in range(0, draws, together)]
    least = [np.concatenate(one) for one in zip(*parts, strict=True)]
    tests = [effective_number_of_tests(one) for one in least]
    levels = [log_family(one, count) for one, count in zip(least, tests, strict=True)]
    smooth = [level for level, family in zip(levels, test_set.families, strict=False) if family.unknown]
    unknowns = effective_number_of_tests(np.min(smooth, axis=0)) if smooth else 1.0
    if drawn is not test_set:
        # outliers are nearly independent tests, so their number grows with the readings
        tests[-1] *= max(float((~test_set.excluded).sum()), 1.0) / max(float((~drawn.excluded).sum()), 1.0)
    return replace(
        test_set, tests=tuple(tests), causes=effective_number_of_tests(np.min(levels, axis=0)), unknowns=unknowns
    )


def _of_some_members(test_set: ScoreTests, rng: np.random.Generator) -> ScoreTests | None:
    """Return the tests of some local members with all their rows, such as one point in ten, drawn evenly.

    The correlations of tests, and so their effective number, follow from the shape of a measurement and not from its
    size. None if there are few rows, or if the members do not show nearly all candidates.
    """
    system = test_set.system
    basis = system.basis
    if system.rows <= 2 * _SAMPLE or basis.members < 2:
        return None
    ends = np.linspace(0, basis.members, basis.members * _SAMPLE // system.rows + 1).astype(int)
    there = np.zeros(basis.members + 1, dtype=bool)
    there[rng.integers(ends[:-1], ends[1:])] = there[-1] = True
    kept = there[basis.member]
    rows = np.flatnonzero(kept)
    own = basis.at(rows)
    # whole members: their local columns stay orthonormal, and orthogonal to the shared ones
    own = replace(own, shared=orthonormal(own.shared, VISIBLE))
    families, lost = [], 0
    for family in test_set.families:
        columns = family.columns.of_rows(kept)
        raw, gram = columns.norms(), columns.grams(own)
        lost += int((ranks_of(roots(gram, raw)) < ranks_of(roots(family.gram, family.raw))).sum())
        families.append(replace(family, columns=columns, raw=raw, gram=gram))
    if lost > _LOST * sum(family.columns.count for family in families):
        return None
    small = replace(system, residual=np.zeros(len(rows)), basis=own, scale=system.scale[rows], idle=0)
    number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    places = number[test_set.places[kept[test_set.places].any(axis=1)]]
    return _with_readings(small, families, places)


def smallest_of_family(columns: Columns, gram: Array, scale: Array, noise: Array, squares: Array, dof: float) -> Array:
    """Return ln of the smallest p-value of a family's alternatives for each draw of noise, (draws,)."""
    return smallest_in_noise(gram, columns.products(noise), scale, squares, dof, np.ones(columns.count, dtype=bool))


def smallest_in_noise(gram: Array, right: Array, scale: Array, squares: Array, dof: float, chosen: Mask) -> Array:
    """Return ln of the smallest p-value of all alternatives for each draw of noise."""
    root = roots(gram, scale)
    gain = ((np.swapaxes(root, 1, 2) @ right) ** 2).sum(axis=1)
    rank = np.where(chosen, ranks_of(root), 0)
    best = np.zeros(len(squares))
    for q in np.unique(rank[rank > 0]):
        most = gain[rank == q].max(axis=0)
        if dof > q:
            best = np.minimum(best, log_tail(np.clip(most / squares, 0.0, 1.0), float(q), dof - q))
    return best


def effective_number_of_tests(log_p: Array) -> float:
    """Return the effective number of independent tests from draws of ln of the smallest p-value of dependent tests.

    It is estimated from the 5, 10, 20 and 30 % quantiles.
    """
    p = np.exp(log_p)
    counts = [np.log1p(-u) / np.log1p(-min(float(np.quantile(p, u)), 1 - 1e-12)) for u in (0.05, 0.1, 0.2, 0.3)]
    return max(1.0, float(np.median(counts)))
