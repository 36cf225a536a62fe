"""Monte Carlo trials in chunks: each chunk is a pure function of its number.

Each chunk has its own random stream from the seed and the number of the chunk.

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.expressions.expression import Expression
from metrocli.frozen import dataclass
from metrocli.uncertainty.inputs import Inputs
from metrocli.uncertainty.numbers import evaluate
from metrocli.uncertainty.samples import BINS, Counts, Edges, Kept

CHUNK, LEAST_CHUNK = 50_000, 10_000
"""Number of trials of a chunk, many enough that their arithmetic takes the time; least of one in an adaptive run"""
LARGEST = 1e150
"""Largest value of a trial: the square of a larger one overflows"""
BLOCK = 10_000
"""Number of trials for which models are evaluated at once: what a step leaves for the next stays in the cache"""
Source = Callable[[np.random.Generator, int], Sequence[tuple[int, Array]]]


@dataclass(frozen=True)
class TrialsPlan:
    """Everything that a chunk needs besides its number: models, quantities, seed, probability, trials."""

    models: tuple[Expression, ...]
    names: tuple[str, ...]
    values: tuple[float, ...]
    """Best estimates of the quantities"""
    centres: tuple[float, ...]
    """Model values at the best estimates; trials are stored as deviations from them"""
    sources: tuple[Source, ...]
    seed: int
    probability: float
    trials: int | None
    """Number of trials; None for an adaptive run"""
    units: tuple[float, ...]
    """Units of the measurands in base units; the digits of an adaptive run refer to values in these units"""

    @property
    def chunk(self) -> int:
        """Number of trials of a chunk; in an adaptive run enough for its own interval (JCGM 101, 7.9.4 a)."""
        if self.trials is not None:
            return CHUNK
        outside = max(1 - self.probability, 1e-15)
        # 100 values beyond the interval in each chunk, so that its ends mean something; 1e-9 undoes rounding of 1 - p
        return max(LEAST_CHUNK, math.ceil(100 / outside * (1 - 1e-9)))

    def count(self, number: int) -> int:
        """Return the number of trials of a chunk; the last chunk of a fixed number can be smaller."""
        return self.chunk if self.trials is None else min(self.chunk, self.trials - number * self.chunk)

    def outcomes(self, number: int) -> Array:
        """Return the deviations of the measurands from their centres in one chunk, (measurands, trials)."""
        # the stream depends on seed and number only; sources draw in a fixed order
        # SFC64 is among the fastest generators of numpy; streams of different spawn keys are independent
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(self.seed, spawn_key=(number,))))
        count = self.count(number)
        values: dict[str, Any] = dict(zip(self.names, self.values, strict=True))
        for source in self.sources:
            for index, deviations in source(rng, count):
                if self.values[index]:
                    deviations += self.values[index]
                values[self.names[index]] = deviations
        drawn = np.empty((len(self.models), count))
        for start in range(0, count, BLOCK):
            part = slice(start, start + BLOCK)
            block = {name: value[part] if isinstance(value, np.ndarray) else value for name, value in values.items()}
            for row, model, centre in zip(drawn, self.models, self.centres, strict=True):
                # deviations from the centre keep the digits that a large best estimate would cost
                np.subtract(evaluate(model, block), centre, out=row[part])
        return drawn


def plan_of(
    models: Mapping[str, Expression],
    inputs: Inputs,
    seed: int,
    probability: float,
    trials: int | None,
    units: Mapping[str, float] | None = None,
) -> TrialsPlan:
    """Return the plan of a run; raises UnreachableError if distributions cannot have their correlation.

    `units` are those of the measurands in base units, 1 by default.
    """
    values = inputs.values
    centres = [float(evaluate(model, values)) for model in models.values()]
    finite = tuple(centre if math.isfinite(centre) else 0.0 for centre in centres)
    sources = inputs.sources()
    means = tuple(values.values())
    shown = tuple((units or {}).get(name, 1.0) for name in models)
    return TrialsPlan(tuple(models.values()), inputs.names, means, finite, sources, seed, probability, trials, shown)


@dataclass(frozen=True)
class Tally:
    """Count, means and sums of products of some trials; the sum of two tallies is that of both sets of trials."""

    count: int
    mean: Array
    products: Array
    """(m, m), of deviations from the means"""

    @classmethod
    def of(cls, outcomes: Array) -> Tally:
        """Return the tally of outcomes (m, trials)."""
        mean = outcomes.mean(axis=1)
        deviations = outcomes - mean[:, None]
        return cls(outcomes.shape[1], mean, deviations @ deviations.T)

    def __add__(self, other: Tally) -> Tally:
        """Return the tally of both (Chan, Golub and LeVeque 1979)."""
        count = self.count + other.count
        apart = other.mean - self.mean
        mean = self.mean + apart * (other.count / count)
        products = self.products + other.products + np.outer(apart, apart) * (self.count * other.count / count)
        return Tally(count, mean, products)

    @property
    def covariance(self) -> Array:
        """(m, m)"""
        return self.products / (self.count - 1)


@dataclass(frozen=True)
class Batch:
    """The outcome of some chunks."""

    tally: Tally
    spread: Array
    """(chunks, 4, m): mean, standard deviation and symmetric interval of each chunk"""
    values: Array | None
    """(m, trials), if all values are kept"""
    counts: Counts | None
    """(m, BINS + 2), if values are counted"""

    def arrays(self) -> dict[str, Any]:
        """Return a counted batch as arrays by name."""
        tally = self.tally
        return {"count": tally.count, "mean": tally.mean, "products": tally.products, "counts": self.counts}

    @classmethod
    def restored(cls, arrays: Mapping[str, Any]) -> Batch:
        """Return the batch of such arrays."""
        tally = Tally(int(arrays["count"]), arrays["mean"], arrays["products"])
        return cls(tally, np.array([]), None, arrays["counts"])


@dataclass(frozen=True)
class Work:
    """Computation of a batch of chunks."""

    plan: TrialsPlan
    chunks: int
    """Number of chunks of a batch"""
    edges: tuple[Edges, ...] = ()
    """Bins of each measurand; empty if all values are kept"""

    def __call__(self, number: int) -> Batch:
        tally: Tally | None = None
        kept: list[Array] = []
        spread: list[Array] = []
        places: list[list[npt.NDArray[np.int32]]] = []
        for chunk in range(number * self.chunks, (number + 1) * self.chunks):
            if self.plan.count(chunk) <= 0:
                break
            drawn = self.plan.outcomes(chunk)
            _refuse_lost(drawn, self.plan)
            tally = Tally.of(drawn) if tally is None else tally + Tally.of(drawn)
            if self.plan.trials is None:
                spread.append(spread_of(drawn, self.plan.probability))
            if self.edges:
                places.append([edges.places(row) for edges, row in zip(self.edges, drawn, strict=True)])
            else:
                kept.append(drawn)
        assert tally is not None
        values = np.concatenate(kept, axis=1) if len(kept) > 1 else next(iter(kept), None)
        return Batch(tally, np.array(spread), values, counted(places) if places else None)


def counted(places: Sequence[Sequence[npt.NDArray[np.int32]]]) -> Counts:
    """Return the number of values in each bin, (m, BINS + 2), from the bins of the values of some chunks."""
    rows = [np.bincount(np.concatenate(column), minlength=BINS + 2) for column in zip(*places, strict=True)]
    return np.array(rows, dtype=np.int64)


class NoOutcomeError(UndeterminedError):
    """Error for trials in which a model has no value."""


def _refuse_lost(values: Array, plan: TrialsPlan) -> None:
    # leaving lost trials out would change the distribution (docs/algorithms/monte-carlo-chunks.md)
    # `not ... < ...`, so that nan is lost as well
    if not np.abs(values).max() < LARGEST:
        lost = ~(np.abs(values) < LARGEST)
        row = int(np.argmax(lost.any(axis=1)))
        raise NoOutcomeError(
            f"{int(lost[row].sum())} of {values.shape[1]} trials of '{plan.models[row].text}' have no value: a root or "
            f"logarithm of a negative number, a division by zero, or a number above {LARGEST:g}.\n"
            "  A distribution reaches beyond what the model allows: bound it (uniform, triangular), or change the model"
        )


def spread_of(values: Array, probability: float) -> Array:
    """Return mean, standard deviation and interval ends of one chunk, (4, m)."""
    ends = np.array([Kept(row).symmetric(probability) for row in values]).T
    return np.vstack([values.mean(axis=1), values.std(axis=1, ddof=1), ends])
