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
    ratio: float
    """Root mean square error in that without the explanation; each in its standard deviation if their units differ"""
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
        """Fraction by which the error decreases, readings of different units together."""
        return 1 - self.ratio

    @property
    def explained(self) -> float:
        """Fraction by which the sum of squares of the errors decreases."""
        return 1 - self.ratio**2


PREDICTED = 100.0
"""Largest variance of a prediction, in that of the noise: a reading that the others hardly determine shows no gain"""


@dataclass(frozen=True)
class FoldPrediction:
    """Prediction of one fold, each reading in its standard deviation."""

    score: float
    errors: Array
    """(n,)"""
    scale: Array
    """Standard deviation of each reading in the unit of the report, nan for readings of other units, (n,)"""
    shares: Array
    """Number of independent errors that each amounts to, (n,)"""
    variances: Array
    """Of the predictions with the noise of the readings, (n,)"""

    def mixed(self, other: FoldPrediction, weight: float) -> FoldPrediction:
        """Return the mean of two predictions of a fold, of which the other one has a probability."""
        if weight >= 1:
            return other
        own = 1 - weight
        score = float(np.logaddexp(np.log(own) + self.score, np.log(weight) + other.score)) if weight else self.score
        errors = own * self.errors + weight * other.errors
        apart = own * weight * (other.errors - self.errors) ** 2
        variances = own * self.variances + weight * other.variances + apart
        return FoldPrediction(score, errors, self.scale, self.shares, variances)


def gain_of(pairs: Sequence[tuple[FoldPrediction, FoldPrediction]]) -> Gain:
    """Return the gain from the predictions of all folds without and with what is judged."""
    differences = np.array([after.score - before.score for before, after in pairs])
    # a single fold shows no scatter: its gain is never called certain
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else float("inf")
    # of both sides, so that the two errors are those of the same readings
    kept = [np.maximum(before.variances, after.variances) <= PREDICTED for before, after in pairs]
    statistics = []
    for side in zip(*pairs, strict=True):
        errors, scale, shares = (
            np.concatenate([getattr(held, name)[own] for held, own in zip(side, kept, strict=True)])
            for name in ("errors", "scale", "shares")
        )
        alike = np.isfinite(scale)
        reported = (errors * scale)[alike]
        # divided by independent errors and not by rows: what local unknowns take of a held-out image shows no error
        rms = float(np.sqrt((reported**2).sum() / max(float(shares[alike].sum()), 1e-9)))
        median = float(np.median(np.abs(reported))) if reported.size else 0.0
        # errors of different units are compared in their standard deviations
        statistics.append((rms, median, rms if alike.all() else float(np.sqrt((errors**2).sum()))))
    (rms, median, size), (rms_after, median_after, size_after) = statistics
    ratio = size_after / size if size > 0 else 1.0
    # the spread of a sum of as many folds, each with that of one
    std = spread * float(np.sqrt(len(differences)))
    score = float(differences.sum())
    return Gain(rms, rms_after, median, median_after, ratio, score, std, tuple(differences.tolist()))
