"""Effective numbers of independent tests, from simulated white noise (Westfall and Young 1993).

A scan over m places takes the smallest p-value of m dependent tests. In draws of white noise, projected like the
residuals, the smallest p-value of k independent tests has the distribution `1 - (1 - p)^k`; k follows from
its quantiles.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.linear.columns import Columns
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.diagnosis.linear.quadratics import ranks_of, roots

LEAST_TESTS = 50.0
"""Fewest independent tests that any library of terms amounts to"""


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
