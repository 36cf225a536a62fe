"""Monte Carlo propagation (JCGM 101 and 102) in chunks, fixed or adaptive, the same to the bit whoever does the chunks.

Each chunk of trials has a random stream of its own, made from the seed and the number of the chunk, and chunks are put
together in their order. Up to KEPT trials all values are kept and sorted; beyond that they are counted in bins.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.uncertainty.expression import Expression
from metrocli.uncertainty.inputs import Inputs
from metrocli.uncertainty.numbers import evaluate
from metrocli.uncertainty.samples import BINS, Binned, Counts, Edges, Sample, Sorted
from metrocli.uncertainty.workers import Workers

Array = npt.NDArray[np.float64]
KEPT = 2_000_000
"""Trials of which all values are kept."""
CHUNK, CHUNKS_OF_A_BATCH, PILOT = 10_000, 100, 10
Source = Callable[[np.random.Generator, int], Sequence[tuple[int, Array]]]


@dataclass(frozen=True)
class Plan:
    """What is drawn and computed: everything that a chunk needs besides its number."""

    models: tuple[Expression, ...]
    names: tuple[str, ...]
    values: tuple[float, ...]
    """Best estimates of the quantities"""
    centres: tuple[float, ...]
    """Model values at the best estimates, from which trials are counted"""
    sources: tuple[Source, ...]
    seed: int
    probability: float
    trials: int | None
    """None: adaptive"""

    @property
    def chunk(self) -> int:
        """Trials of one chunk: enough for the probability (JCGM 101, 7.9.4 a)."""
        return max(CHUNK, math.ceil(100 / (1 - self.probability) * (1 - 1e-9)))

    def count(self, number: int) -> int:
        """Return the trials of a chunk; the last one of a fixed number may be smaller."""
        return self.chunk if self.trials is None else min(self.chunk, self.trials - number * self.chunk)

    def outcomes(self, number: int) -> Array:
        """Return the deviations of the measurands from their centres in one chunk, (measurands, trials)."""
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(self.seed, spawn_key=(number,))))
        count = self.count(number)
        values: dict[str, Any] = dict(zip(self.names, self.values, strict=True))
        for source in self.sources:
            for index, deviations in source(rng, count):
                deviations += self.values[index]
                values[self.names[index]] = deviations
        found = np.empty((len(self.models), count))
        for row, model, centre in zip(found, self.models, self.centres, strict=True):
            np.subtract(evaluate(model, values), centre, out=row)
        return found


def plan_of(
    models: Mapping[str, Expression], inputs: Inputs, seed: int, probability: float, trials: int | None
) -> Plan:
    """Return the plan of a run; raises UnreachableError where correlations cannot be drawn."""
    values = inputs.values
    centres = [float(evaluate(model, values)) for model in models.values()]
    finite = tuple(centre if math.isfinite(centre) else 0.0 for centre in centres)
    sources = inputs.sources()
    means = tuple(values.values())
    return Plan(tuple(models.values()), inputs.names, means, finite, sources, seed, probability, trials)


@dataclass(frozen=True)
class Tally:
    """Counts, means and sums of products of some trials; two of them add up to those of both."""

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
    """What comes back of some chunks."""

    tally: Tally
    spread: Array
    """(chunks, 4, m): mean, standard deviation and symmetric interval of each chunk"""
    values: Array | None
    """(m, trials), where all are kept"""
    counts: Counts | None
    """(m, BINS + 2), where they are counted"""

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
class _Work:
    """Do batches of chunks."""

    plan: Plan
    chunks: int
    """Of one batch"""
    edges: tuple[Edges, ...] = ()
    """Of each measurand; empty where all values are kept"""

    def __call__(self, number: int) -> Batch:
        tally: Tally | None = None
        kept: list[Array] = []
        spread: list[Array] = []
        places: list[list[npt.NDArray[np.int32]]] = []
        for chunk in range(number * self.chunks, (number + 1) * self.chunks):
            if self.plan.count(chunk) <= 0:
                break
            found = self.plan.outcomes(chunk)
            _refuse_lost(found, self.plan)
            tally = Tally.of(found) if tally is None else tally + Tally.of(found)
            if self.plan.trials is None:
                spread.append(_spread(found, self.plan.probability))
            if self.edges:
                places.append([edges.places(row) for edges, row in zip(self.edges, found, strict=True)])
            else:
                kept.append(found)
        assert tally is not None
        values = np.concatenate(kept, axis=1) if kept else None
        return Batch(tally, np.array(spread), values, _counted(places) if places else None)


def _counted(places: Sequence[Sequence[npt.NDArray[np.int32]]]) -> Counts:
    rows = [np.bincount(np.concatenate(column), minlength=BINS + 2) for column in zip(*places, strict=True)]
    return np.array(rows, dtype=np.int64)


class NoOutcomeError(UndeterminedError):
    """Trials in which a model has no value."""


def _refuse_lost(found: Array, plan: Plan) -> None:
    lost = ~np.isfinite(found)
    if lost.any():
        row = int(np.argmax(lost.any(axis=1)))
        raise NoOutcomeError(
            f"{int(lost[row].sum())} of {found.shape[1]} trials of '{plan.models[row].text}' have no value: a root or "
            "logarithm of a negative number, or a division by zero\n"
            "  a distribution reaches beyond what the model allows: bound it (uniform, triangular), or change the model"
        )


def _spread(found: Array, probability: float) -> Array:
    ordered = np.sort(found, axis=1)
    ends = np.array([Sorted(row).symmetric(probability) for row in ordered]).T
    return np.vstack([found.mean(axis=1), found.std(axis=1, ddof=1), ends])


@dataclass(frozen=True)
class Outcome:
    """What Monte Carlo says of the measurands."""

    means: Array
    covariance: Array
    samples: tuple[Sample, ...]
    """Of each measurand, as deviations from `centres`"""
    centres: tuple[float, ...]
    trials: int
    errors: Array
    """(4, m): standard deviations of mean, standard deviation and interval ends, where the run was adaptive"""


def run(plan: Plan, workers: Workers, digits: int = 2, most: int = 0) -> Outcome:
    """Carry out the trials; raises NoOutcomeError, and NotConvergedError at `most` trials of an adaptive run."""
    if plan.trials is None:
        return _adaptive(plan, workers, digits, most)
    chunks = math.ceil(plan.trials / plan.chunk)
    if plan.trials <= KEPT:
        work = _Work(plan, 1 if chunks < CHUNKS_OF_A_BATCH else 10)
        numbers = range(math.ceil(chunks / work.chunks))
        return _gathered(plan, list(_told(workers.ordered(work, numbers), workers, len(numbers))))
    work = _Work(plan, CHUNKS_OF_A_BATCH, _edges(plan))
    numbers = range(math.ceil(chunks / work.chunks))
    total: Batch | None = None
    for batch in _told(_resumed(work, workers, numbers), workers, len(numbers)):
        total = batch if total is None else _both(total, batch)
    assert total is not None
    workers.finished.clear()
    return _outcome(plan, total, work.edges)


def _told(batches: Iterator[Batch], workers: Workers, of: int | None) -> Iterator[Batch]:
    for done, batch in enumerate(batches, 1):
        yield batch
        workers.tell(done, of)


def _edges(plan: Plan) -> tuple[Edges, ...]:
    pilot = _Work(plan, PILOT)(0).values
    assert pilot is not None
    return tuple(Edges.around(row) for row in pilot)


def _resumed(work: _Work, workers: Workers, numbers: Sequence[int]) -> Iterator[Batch]:
    """Yield all batches in order: those that an earlier run has finished as they were kept, the others done now."""
    key = hashlib.sha256(pickle.dumps((work, np.__version__), protocol=4)).hexdigest()[:16]
    kept = ((number, workers.finished.get(key, number)) for number in numbers)
    held = {number: Batch.restored(arrays) for number, arrays in kept if arrays is not None}
    missing = [number for number in numbers if number not in held]
    done = workers.ordered(work, missing)
    for number in numbers:
        if number in held:
            yield held.pop(number)
        else:
            batch = next(done)
            workers.finished.put(key, number, batch.arrays())
            yield batch


def _both(a: Batch, b: Batch) -> Batch:
    counts = None if a.counts is None or b.counts is None else a.counts + b.counts
    return Batch(a.tally + b.tally, np.concatenate([a.spread, b.spread]), None, counts)


def _gathered(plan: Plan, batches: Sequence[Batch]) -> Outcome:
    """Put kept values together."""
    total = batches[0]
    for batch in batches[1:]:
        total = _both(total, batch)
    values = np.concatenate([batch.values for batch in batches if batch.values is not None], axis=1)
    return _outcome(plan, replace(total, values=values), ())


def _outcome(plan: Plan, total: Batch, edges: tuple[Edges, ...]) -> Outcome:
    samples: tuple[Sample, ...]
    if total.values is not None:
        samples = tuple(Sorted(np.sort(row)) for row in total.values)
    else:
        assert total.counts is not None
        samples = tuple(Binned(bins, counts) for bins, counts in zip(edges, total.counts, strict=True))
    means = total.tally.mean + np.asarray(plan.centres)
    errors = _errors(total.spread) if len(total.spread) > 1 else np.zeros((4, len(means)))
    return Outcome(means, total.tally.covariance, samples, plan.centres, total.tally.count, errors)


def _errors(spread: Array) -> Array:
    """Return the standard deviations of the averages over all chunks (JCGM 101, 7.9.4 g)."""
    errors: Array = spread.std(axis=0, ddof=1) / math.sqrt(len(spread))
    return errors


def tolerance_of(std: float, digits: int) -> float:
    """Return half of the last digit that is meant when a standard uncertainty is given to `digits` (7.9.2)."""
    if not std > 0:
        return 0.0
    exponent = math.floor(math.log10(float(f"{std:.{digits - 1}e}"))) - (digits - 1)
    return float(0.5 * 10.0**exponent)


def _adaptive(plan: Plan, workers: Workers, digits: int, most: int) -> Outcome:
    """Add chunks until mean, standard uncertainty and interval ends are known to the digits wanted (JCGM 101, 7.9)."""
    kept: list[Batch] = []
    settled = False
    for batch in _told(workers.ordered(_Work(plan, 1), range(min(most, KEPT) // plan.chunk)), workers, None):
        kept.append(batch)
        if len(kept) > 1 and _settled(kept, digits):
            settled = True
            break
    outcome = _gathered(plan, kept)
    if settled:
        return outcome
    edges = tuple(Edges.around(row.values) for row in outcome.samples if isinstance(row, Sorted))
    total = Batch(_tally(kept), np.concatenate([batch.spread for batch in kept]), None, _binned(outcome, edges))
    first = len(kept)
    del kept
    later = itertools.takewhile(lambda n: (first + n * 10) * plan.chunk < most, itertools.count())
    for batch in _told(workers.ordered(_Later(_Work(plan, 10, edges), first), later), workers, None):
        total = _both(total, batch)
        if _small(total.tally, total.spread, digits):
            return _outcome(plan, total, edges)
    raise NotConvergedError(_unsettled(total.tally, total.spread, digits))


@dataclass(frozen=True)
class _Later:
    """Batches of chunks that begin behind those done one by one."""

    work: _Work
    first: int

    def __call__(self, number: int) -> Batch:
        whole = replace(self.work, chunks=1)
        start = self.first + number * self.work.chunks
        batches = [whole(chunk) for chunk in range(start, start + self.work.chunks)]
        total = batches[0]
        for batch in batches[1:]:
            total = _both(total, batch)
        return total


def _binned(outcome: Outcome, edges: Sequence[Edges]) -> Counts:
    rows = [sample.values for sample in outcome.samples if isinstance(sample, Sorted)]
    return _counted([[bins.places(row) for bins, row in zip(edges, rows, strict=True)]])


def _tally(batches: Sequence[Batch]) -> Tally:
    total = batches[0].tally
    for batch in batches[1:]:
        total = total + batch.tally
    return total


def _settled(batches: Sequence[Batch], digits: int) -> bool:
    return _small(_tally(batches), np.concatenate([batch.spread for batch in batches]), digits)


def _small(tally: Tally, spread: Array, digits: int) -> bool:
    std = np.sqrt(np.diag(tally.covariance))
    wanted = np.array([tolerance_of(float(s), digits) for s in std])
    return bool((2 * _errors(spread) <= wanted).all())


def _unsettled(tally: Tally, spread: Array, digits: int) -> str:
    errors = 2 * _errors(spread)
    std = np.sqrt(np.diag(tally.covariance))
    worst = np.array([errors[:, m].max() / (tolerance_of(float(s), digits) or 1.0) for m, s in enumerate(std)])
    less = f"{worst.max():.1f} times less well than {digits} digits of the standard uncertainty ask for"
    hint = "ask for fewer digits, allow more trials (`most`), or fix their number (`trials`)"
    return f"after {tally.count} trials the results are known {less}\n  {hint}"
