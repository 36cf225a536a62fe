"""Ranges of what the tables predict or a test reads, with their U by draws (JCGM 101)."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.tasks.calibrate_machine.acceptance.positioning import COVERAGE

_DRAWS, _PARTS, _SEED = 4_000, 40, 20
"""Draws of a range, and in how many parts they are used: its U then scatters by 1.1 %"""


@dataclass(frozen=True)
class Profile:
    """Deviations along a path with their derivatives by the unknowns of the tables."""

    values: Array
    """(n,)"""
    rows: Array
    """(n, unknowns)"""
    drawn: Array
    """Errors of the unknowns, drawn with their covariance, (draws, unknowns)"""

    def range_with_u(self) -> tuple[float, float]:
        """Return the range of the deviations, and its U (k = 2) from draws of their errors (JCGM 101).

        Where several points come near the extremes, the range scatters less than two fixed points do, and it is too
        large on average. So `U = k sqrt(mean (range - drawn range)^2)`, which contains both. Noise also drives the
        deviations apart, and would hide how near they are: errors are drawn about the deviations times the share of
        their variance that is not noise (James and Stein 1961).
        """
        own = self.values - self.values.mean()
        rows = self.rows - self.rows.mean(axis=0)
        noise = float(np.mean((rows @ (self.drawn.T @ self.drawn / len(self.drawn)) * rows).sum(axis=1)))
        true = own * max(1 - noise / max(np.var(own), noise, np.finfo(float).tiny), 0.0)
        # parts that stay in the cache of the processor
        parts = (np.ptp(true + part @ rows.T, axis=1) for part in np.array_split(self.drawn, _PARTS))
        return float(np.ptp(own)), float(COVERAGE * np.sqrt(np.mean((np.concatenate(list(parts)) - np.ptp(true)) ** 2)))


def draws(covariance: Array) -> Array:
    """Return errors of unknowns drawn with their covariance, (draws, unknowns).

    The root of the correlation is the symmetric one: it is the same whatever basis rounding chooses for directions of
    equal variance.
    """
    scale = np.sqrt(np.where(np.diag(covariance) > 0, np.diag(covariance), 1.0))
    size, along = np.linalg.eigh(covariance / scale[:, None] / scale)
    root = (along * np.sqrt(np.maximum(size, 0.0))) @ along.T * scale
    return np.asarray(np.random.default_rng(_SEED).normal(size=(_DRAWS, len(root))) @ root)
