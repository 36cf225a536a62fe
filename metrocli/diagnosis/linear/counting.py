"""Effective numbers of independent tests, from simulated white noise (Westfall and Young 1993).

A scan over m places takes the smallest p-value of m dependent tests. In draws of white noise, projected like the
residuals, the smallest p-value of k independent tests has the distribution `1 - (1 - p)^k`; k follows from
its quantiles.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.decompositions import orthonormalised
from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.candidates import CandidateGroup
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.diagnosis.linear.projection import VISIBLE, Linearised
from metrocli.diagnosis.linear.quadratics import ranks_of, roots

LEAST_TESTS = 50.0
"""Fewest independent tests that any library of terms amounts to"""
_SAMPLE = 12_000
"""Rows of the local members whose noise is drawn, if a measurement has more than twice as many"""
_LOST = 0.05
"""Largest share of the candidates that these members may not show"""


def smallest_of_family(family: CandidateGroup, noise: Array, squares: Array, dof: float) -> Array:
    """Return ln of the smallest p-value of a family's alternatives for each draw of noise, (draws,)."""
    root = roots(family.gram, family.raw)
    gain = ((np.swapaxes(root, 1, 2) @ family.columns.products(noise)) ** 2).sum(axis=1)
    rank = ranks_of(root)
    best = np.zeros(len(squares))
    # alternatives of different rank have different tails: their smallest p is compared, and not the squares
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
    # 1 - (1 - p)^k = u solved for k, at levels near those of a price
    counts = [np.log1p(-u) / np.log1p(-min(float(np.quantile(p, u)), 1 - 1e-12)) for u in (0.05, 0.1, 0.2, 0.3)]
    return max(1.0, float(np.median(counts)))


def of_some_members(
    system: Linearised, families: Sequence[CandidateGroup], rng: np.random.Generator
) -> tuple[Linearised, Sequence[CandidateGroup]]:
    """Return a system of some local members with all their rows, such as one point in ten, drawn evenly.

    The correlations of tests, and so their effective number, follow from the shape of a measurement and not from its
    size. Returned is the given one if it has few rows, or if the members do not show nearly all candidates.
    """
    basis = system.basis
    if system.rows <= 2 * _SAMPLE or basis.members < 2:
        return system, families
    # one member from each stretch: a plain draw could leave out a whole region
    ends = np.linspace(0, basis.members, basis.members * _SAMPLE // system.rows + 1).astype(int)
    there = np.zeros(basis.members + 1, dtype=bool)
    there[rng.integers(ends[:-1], ends[1:])] = there[-1] = True
    kept = there[basis.member]
    rows = np.flatnonzero(kept)
    own = basis.at(rows)
    # whole members: their local columns stay orthonormal, and orthogonal to the shared ones
    own = replace(own, shared=orthonormalised(own.shared, VISIBLE)[0])
    fewer, lost = list[CandidateGroup](), 0
    for family in families:
        columns = family.columns.of_rows(kept)
        raw, gram = columns.norms(), columns.grams(own)
        lost += int((ranks_of(roots(gram, raw)) < ranks_of(roots(family.gram, family.raw))).sum())
        fewer.append(replace(family, columns=columns, raw=raw, gram=gram))
    if lost > _LOST * sum(family.columns.count for family in families):
        return system, families
    return replace(system, residual=np.zeros(len(rows)), basis=own, scale=system.scale[rows]), fewer
