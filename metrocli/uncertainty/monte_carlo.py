"""Monte Carlo propagation (JCGM 101 and 102) with a fixed or adaptive number of trials.

Chunks are joined in their order, so the result is identical to the bit for any number of workers. Up to KEPT trials
all values are kept; larger numbers of trials are counted in bins.

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np

from metrocli.arrays import Array, keep_memory
from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass
from metrocli.uncertainty.samples import Binned, Counts, Edges, Kept, MeasurandSample
from metrocli.uncertainty.trials import Batch, Tally, TrialsPlan, Work, counted
from metrocli.uncertainty.workers import Workers

KEPT, KEPT_VALUES = 2_000_000, 8_000_000
"""Largest number of trials of which all values are kept, and of values of all measurands together"""
CHUNKS_OF_A_BATCH, PILOT = 20, 2
MOST_OF_TWO_CHUNKS = 10_000_000
"""Largest number of trials in two chunks of an adaptive run, so that they fit into memory"""


@dataclass(frozen=True)
class MonteCarloResult:
    """The Monte Carlo result of the measurands."""

    means: Array
    covariance: Array
    samples: tuple[MeasurandSample, ...]
    """Sample of each measurand, as deviations from `centres`"""
    centres: tuple[float, ...]
    trials: int


def run(plan: TrialsPlan, workers: Workers, digits: int = 2, most: int = 0) -> MonteCarloResult:
    """Return the result of the trials of a plan.

    Raises NoOutcomeError if a trial has no value, NotConvergedError if an adaptive run reaches `most` trials.
    """
    keep_memory()
    if plan.trials is None:
        return _adaptive(plan, workers, digits, most)
    chunks = math.ceil(plan.trials / plan.chunk)
    if plan.trials <= _kept(plan):
        work, numbers = Work(plan, 1), range(chunks)
        return _gathered(plan, list(_with_progress(workers.ordered(work, numbers), workers, len(numbers))))
    work = Work(plan, CHUNKS_OF_A_BATCH, _edges(plan))
    numbers = range(math.ceil(chunks / work.chunks))
    total: Batch | None = None
    for batch in _with_progress(_resumed(work, workers, numbers), workers, len(numbers)):
        total = batch if total is None else _both(total, batch)
    assert total is not None
    workers.finished.clear()
    return _outcome(plan, total, work.edges)


def _kept(plan: TrialsPlan) -> int:
    """Return the number of trials up to which all values are kept."""
    return min(KEPT, KEPT_VALUES // len(plan.models))


def _with_progress(batches: Iterator[Batch], workers: Workers, of: int | None) -> Iterator[Batch]:
    for done, batch in enumerate(batches, 1):
        yield batch
        workers.tell(done, of)


def _edges(plan: TrialsPlan) -> tuple[Edges, ...]:
    pilot = Work(plan, PILOT)(0).values
    assert pilot is not None
    return tuple(Edges.around(row) for row in pilot)


def _resumed(work: Work, workers: Workers, numbers: Sequence[int]) -> Iterator[Batch]:
    """Yield all batches in order: stored ones of an earlier run, and the others computed now."""
    # with the version of numpy, whose streams and functions may round differently
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


def _gathered(plan: TrialsPlan, batches: Sequence[Batch]) -> MonteCarloResult:
    """Return the result from batches whose values are all kept."""
    total = reduce(_both, batches)
    values = np.concatenate([batch.values for batch in batches if batch.values is not None], axis=1)
    return _outcome(plan, replace(total, values=values), ())


def _outcome(plan: TrialsPlan, total: Batch, edges: tuple[Edges, ...]) -> MonteCarloResult:
    samples: tuple[MeasurandSample, ...]
    if total.values is not None:
        samples = tuple(map(Kept, total.values))
    else:
        assert total.counts is not None
        samples = tuple(Binned(bins, counts) for bins, counts in zip(edges, total.counts, strict=True))
    means = total.tally.mean + np.asarray(plan.centres)
    return MonteCarloResult(means, total.tally.covariance, samples, plan.centres, total.tally.count)


def _errors(spread: Array) -> Array:
    """Return the standard deviations of the averages over all chunks (JCGM 101, 7.9.4 g)."""
    errors: Array = spread.std(axis=0, ddof=1) / math.sqrt(len(spread))
    return errors


def tolerance_of(std: float, digits: int) -> float:
    """Return the numerical tolerance: half of the last of `digits` significant digits of u (JCGM 101, 7.9.2)."""
    if not std > 0:
        return 0.0
    # rounded to its digits first: 0.0996 has the last digit of 0.10
    exponent = math.floor(math.log10(float(f"{std:.{digits - 1}e}"))) - (digits - 1)
    return float(0.5 * 10.0**exponent)


def _adaptive(plan: TrialsPlan, workers: Workers, digits: int, most: int) -> MonteCarloResult:
    """Add chunks until mean, standard uncertainty and interval ends are accurate to `digits` (JCGM 101, 7.9)."""
    if 2 * plan.chunk > min(most, MOST_OF_TWO_CHUNKS):
        raise NotConvergedError(
            f"{100 * plan.probability:.12g} % needs chunks of {plan.chunk} trials in an adaptive run "
            f"(JCGM 101, 7.9.4 a), and two of them are more than {min(most, MOST_OF_TWO_CHUNKS)}\n"
            "  fix the number of trials (`trials`), or choose a smaller probability or k"
        )
    kept: list[Batch] = []
    converged = False
    numbers = range(max(min(most, _kept(plan)) // plan.chunk, 2))
    for batch in _with_progress(workers.ordered(Work(plan, 1), numbers), workers, None):
        kept.append(batch)
        # a standard deviation over chunks needs two of them
        if len(kept) > 1 and _small(_tally(kept), np.concatenate([batch.spread for batch in kept]), plan.units, digits):
            converged = True
            break
    outcome = _gathered(plan, kept)
    if converged:
        return outcome
    # from all values so far, which reach farther than a pilot run
    edges = tuple(Edges.around(row.values) for row in outcome.samples if isinstance(row, Kept))
    total = Batch(_tally(kept), np.concatenate([batch.spread for batch in kept]), None, _binned(outcome, edges))
    first = len(kept)
    del kept
    later = itertools.takewhile(lambda n: (first + n * 10) * plan.chunk < most, itertools.count())
    for batch in _with_progress(workers.ordered(_Later(Work(plan, 10, edges), first), later), workers, None):
        total = _both(total, batch)
        if _small(total.tally, total.spread, plan.units, digits):
            return _outcome(plan, total, edges)
    raise NotConvergedError(_unsettled(total.tally, total.spread, plan.units, digits))


@dataclass(frozen=True)
class _Later:
    """Work on batches of chunks that follow the chunks done one by one."""

    work: Work
    first: int

    def __call__(self, number: int) -> Batch:
        whole = replace(self.work, chunks=1)
        start = self.first + number * self.work.chunks
        return reduce(_both, map(whole, range(start, start + self.work.chunks)))


def _binned(outcome: MonteCarloResult, edges: Sequence[Edges]) -> Counts:
    rows = [sample.values for sample in outcome.samples if isinstance(sample, Kept)]
    return counted([[bins.places(row) for bins, row in zip(edges, rows, strict=True)]])


def _tally(batches: Sequence[Batch]) -> Tally:
    return reduce(add, (batch.tally for batch in batches))


def _small(tally: Tally, spread: Array, units: Sequence[float], digits: int) -> bool:
    return bool((2 * _errors(spread) <= _wanted(tally, units, digits)).all())


def _wanted(tally: Tally, units: Sequence[float], digits: int) -> Array:
    """Return the numerical tolerance of each measurand, from its standard uncertainty in its own unit."""
    std = np.sqrt(np.diag(tally.covariance))
    return np.array([unit * tolerance_of(float(s) / unit, digits) for s, unit in zip(std, units, strict=True)])


def _unsettled(tally: Tally, spread: Array, units: Sequence[float], digits: int) -> str:
    wanted = _wanted(tally, units, digits)
    worst = 2 * _errors(spread).max(axis=0) / np.where(wanted > 0, wanted, 1.0)
    less = f"{worst.max():.1f} times less well than {digits} digits of the standard uncertainty require"
    hint = "choose fewer digits, allow more trials (`most`), or fix their number (`trials`)"
    return f"after {tally.count} trials the results are known {less}\n  {hint}"
