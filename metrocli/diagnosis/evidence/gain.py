"""The gain of an explanation: how much better held-out readings are predicted with it.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Gain:
    """Gain of an explanation: how much better held-out readings are predicted with it."""

    before: float
    """Root mean square error of prediction, in the internal unit of the readings"""
    after: float
    median_before: float
    median_after: float
    log_score: float
    log_score_std: float
    folds: tuple[float, ...] = ()
    """Part of each held-out part of the readings in the log score"""

    @property
    def shown(self) -> bool:
        """Whether the gain exceeds twice its standard error."""
        return self.log_score > 2 * self.log_score_std

    @property
    def reduction(self) -> float:
        """Fraction by which the error decreases."""
        return 1 - self.after / self.before if self.before > 0 else 0.0


@dataclass(frozen=True)
class Held:
    """Prediction of one fold."""

    score: float
    errors: Array
    """Errors of prediction of the readings, in the unit in which they are reported"""
    directions: float
    """Number of independent errors that they amount to"""


def gain_of(pairs: Sequence[tuple[Held, Held]]) -> Gain:
    """Return the gain from the predictions of all folds without and with what is judged."""
    differences = np.array([after.score - before.score for before, after in pairs])
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else float("inf")
    sides = list(zip(*pairs, strict=True))
    rms = [
        float(np.sqrt(sum((h.errors**2).sum() for h in side) / max(sum(h.directions for h in side), 1e-9)))
        for side in sides
    ]
    medians = [float(np.median(np.abs(np.concatenate([held.errors for held in side])))) for side in sides]
    std = spread * float(np.sqrt(len(differences)))
    return Gain(rms[0], rms[1], medians[0], medians[1], float(differences.sum()), std, tuple(differences.tolist()))
