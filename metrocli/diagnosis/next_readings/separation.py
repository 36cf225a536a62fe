"""The chance that readings decide between a named effect and its rival: confidence sets of readings drawn at random.

Method: docs/algorithms/next-readings.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.evidence.identified import explains_as_well
from metrocli.diagnosis.linear.quadratics import ranks_of, roots
from metrocli.diagnosis.next_readings.pool import Pool
from metrocli.frozen import dataclass

_DRAWS, _SEED = 2000, 105


@dataclass(frozen=True)
class _Fits:
    """What readings show of some columns of a pool, in many draws of the readings."""

    gains: Array
    """Reduction of the sum of squares, (draws,)"""
    rank: int
    along: Array
    """Coordinates in an orthonormal basis of the columns, (draws, q)"""
    root: Array
    """From that basis to sizes, (q, q)"""

    def evidence(self, squares: Array, dof: int) -> Array:
        """Return ln of the evidence, but for the count of tests (Schwarz 1978), (draws,)."""
        return np.asarray(-(dof * np.log(squares - self.gains) + self.rank * np.log(dof)) / 2)


def chance_to_separate(now: Pool, then: Pool, columns: int, odds: float) -> float:
    """Return the chance that the readings made in `then` leave the true one of two effects only.

    The first `columns` of the pools are those of the named effect, the others those of its rival, which is the true one
    with these odds. Sizes are drawn as the readings so far have them, readings with their noise. What is left is what
    the confidence sets leave.
    """
    rng = np.random.default_rng(_SEED)
    named, rival = slice(0, columns), slice(columns, len(now.gram))
    before = [_fits(now, part, now.right[None]) for part in (named, rival)]
    evidences = [fits.evidence(np.array([now.squares]), now.dof)[0] for fits in before]
    counted = float(np.log(odds) - (evidences[1] - evidences[0]))
    chance = 0.0
    for true, weight in ((0, 1 / (1 + odds)), (1, odds / (1 + odds))):
        fit, part = before[true], (named, rival)[true]
        sizes = (fit.along + rng.normal(size=(_DRAWS, fit.along.shape[1]))) @ fit.root.T
        read = sizes @ then.made[:, part].T + rng.normal(size=(_DRAWS, len(then.made)))
        right, squares = now.right + read @ then.made, now.squares + (read**2).sum(axis=1)
        both = [_fits(then, own, right) for own in (named, rival)]
        more = [fits.evidence(squares, then.dof) for fits in both]
        log_odds = (more[0] - more[1] - counted) * (1 if true else -1)
        left = ~_explains(then, both[true], both[1 - true], (part, (rival, named)[true]), squares, log_odds)
        chance += weight * float((left & (log_odds < 0)).mean())
    return chance


def _fits(pool: Pool, own: slice, right: Array) -> _Fits:
    root = roots(pool.gram[None, own, own], pool.raw[None, own])[0]
    along = right[:, own] @ root
    return _Fits((along**2).sum(axis=1), int(ranks_of(root[None])[0]), along, root)


def _explains(
    pool: Pool, fits: _Fits, other: _Fits, parts: tuple[slice, slice], squares: Array, log_odds: Array
) -> Mask:
    """Return in which draws another effect explains the readings as well as one that is identified, (draws,)."""
    across = fits.root.T @ pool.gram[parts[0], parts[1]] @ other.root
    cosines2 = ((fits.along @ across) ** 2).sum(axis=1) / np.maximum(fits.gains, 1e-300)
    variance = (squares - fits.gains) / max(pool.dof - fits.rank, 1)
    return explains_as_well(log_odds, np.minimum(cosines2, 1.0), fits.gains / variance)
