"""The noise that was found: its level relative to the declared one, and units (a tracer, an image) that are noisier.

Method: docs/algorithms/selection-and-levels.md (noise).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.distributions import chi_interval, log_tail
from metrocli.diagnosis.linear.fitted_columns import PRIOR, FittedColumns
from metrocli.diagnosis.linear.projection import FEWEST, READING, System
from metrocli.diagnosis.linear.restricted_likelihood import RestrictedLikelihood
from metrocli.diagnosis.selection.all_of_a_kind import AS_MUCH, Instead
from metrocli.diagnosis.selection.backward_steps import evidence_of
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.frozen import dataclass

_LEVEL = 1e-3
"""Level at which a unit counts as noisier or quieter, divided by the number of units"""
APART = 1.4
"""Ratio of standard deviations below which a unit's weight is not changed"""
_SMALL = 0.05
"""Share of all redundancy below which the noise of one unit is hardly in the residuals of another"""
_NEARLY = 0.5
"""Least share of the ln of the first unit's level that further units of its kind have in the same step"""
DECLARED_SIGMA = "given"
"""Key of a unit of prior values that the job states with a sigma, such as known points"""
_MOST_ROWS = 8
"""Largest number of rows of a unit, for each parameter of the effects at it, whose noise these can imitate"""
_LEAST = 0.1
"""Smallest factor on the standard deviation of prior values in one step"""


@dataclass(frozen=True)
class Noise:
    """The noise of the readings relative to the declared one, with its 95 % interval."""

    ratio: float
    low: float
    high: float
    dof: float
    """Degrees of freedom from which it was found"""

    @property
    def as_declared(self) -> bool:
        """Whether its interval contains the declared noise."""
        return self.low <= 1 <= self.high


@dataclass(frozen=True)
class Unit:
    """A part of the readings, or of the prior values, that has a noise of its own."""

    key: str
    """The kind of place, or `DECLARED_SIGMA`"""
    name: str
    ratio: float
    """Ratio of its standard deviation to that of the others"""
    log_level: float = 0.0
    """ln of the significance level of its test, counted over all units"""


def noise_of(fitted: FittedColumns) -> Noise:
    """Return the noise that remains, with its 95 % interval (chi-squared)."""
    squares, dof = fitted.squares - fitted.prior, max(fitted.dof - PRIOR, 1.0)
    low, high = chi_interval(squares, dof)
    return Noise(float(np.sqrt(squares / dof)), low, high, dof)


def noisier_units(job: AdjustedJob, system: System, fitted: FittedColumns, most: int = 1) -> tuple[Unit, ...]:
    """Return units whose noise differs most from that of the others, at most so many; none if these may be chance.

    The score test of its variance compares `|r_u|^2 / |r|^2` with its null distribution: the beta distribution that has
    the moments of this share in white noise. For prior values there is also an F test with and without them. The
    ratio follows by equating sums of squares to their expectations (MINQUE, Rao 1971).
    After the first, small units of its kind follow that are nearly as improbable without the readings of those before.
    """
    units = list(_units(job, system))
    if len(units) < 2:
        return ()
    taken = system.basis.with_shared(fitted.basis)
    tested = [_Tested.of(*one, taken, fitted) for one in units]
    tested = [one for one in tested if one.redundancy >= 1]
    taken_out = _Tested("", "", np.zeros(system.rows, dtype=bool), 0.0, 0.0, 0.0)
    found: list[Unit] = []
    needed, small = float(np.log(_LEVEL / len(units))), _SMALL * fitted.dof
    while tested and len(found) < most:
        levels = [one.log_level(system, fitted, taken_out) for one in tested]
        best = int(np.argmin(levels))
        one, log_p = tested[best], levels[best]
        ratio = _ratio(system, fitted, one.rows, taken_out.rows) if log_p <= needed else 1.0
        if one.key == DECLARED_SIGMA:
            ratio = max(ratio, _LEAST)
        if 1 / APART < ratio < APART:
            break
        found.append(Unit(one.key, one.name, ratio, log_p + float(np.log(len(units)))))
        needed = min(needed, _NEARLY * log_p)
        taken_out = taken_out.joined(one)
        tested = [other for other in tested if other.key == one.key and other is not one]
        tested = [other for other in tested if max(one.redundancy, other.redundancy) < small]
    return tuple(found)


@dataclass(frozen=True)
class _Tested:
    """The readings of a unit, with what the test of their noise takes from the fit."""

    key: str
    name: str
    rows: Mask
    redundancy: float
    second: float
    """`tr A^2` of their quadratic form A"""
    squares: float

    @staticmethod
    def of(key: str, name: str, rows: Mask, taken: Basis, fitted: FittedColumns) -> _Tested:
        """Return the unit of some rows, beside all columns that the fit has taken out."""
        trace, squares = taken.squares_of_gram(rows)
        redundancy = float(rows.sum()) - trace
        return _Tested(key, name, rows, redundancy, redundancy - trace + squares, _squares(fitted, rows))

    def joined(self, other: _Tested) -> _Tested:
        """Return the rows of both, whose residuals count as independent."""
        redundancy, squares = self.redundancy + other.redundancy, self.squares + other.squares
        return replace(self, rows=self.rows | other.rows, redundancy=redundancy, squares=squares)

    def log_level(self, system: System, fitted: FittedColumns, without: _Tested) -> float:
        """Return ln of the level of its noise against that of the others without some of them."""
        share = self.squares / max(float(fitted.residual @ fitted.residual) - without.squares, 1e-300)
        dof = fitted.dof - PRIOR - without.redundancy
        log_p = log_tail_of_share(share, *moments_of_share(dof, self.redundancy, self.second))
        return min(log_p, _log_without(system, fitted, self.rows)) if self.key == DECLARED_SIGMA else log_p


def _squares(fitted: FittedColumns, rows: Mask) -> float:
    return float((fitted.residual[rows] ** 2).sum())


def noise_instead(job: AdjustedJob, selection: Selection) -> Unit | None:
    """Return the unit whose larger noise has more evidence than the effects at it with the wrong readings there.

    An effect at a unit of few readings, such as a bad pose, explains much of what is only noise, and hides it from the
    test beside all names. So the noise is held against it: by its restricted likelihood, with its variance as one
    parameter and its choice among all units (Schwarz 1978).
    """
    ahead = [(by, unit) for by, unit, _ in _held_against_names(job, selection) if by > 0]
    return max(ahead, key=lambda pair: pair[0])[1] if ahead else None


def noise_as_likely(job: AdjustedJob, selection: Selection, one: Chosen) -> tuple[Instead, ...]:
    """Return the noise of each unit that explains the readings about as well as a name there."""
    held = [(by, unit) for by, unit, own in _held_against_names(job, selection) if any(one is other for other in own)]
    return tuple(Instead("noise", {unit.key: unit.name}, float(np.exp(by))) for by, unit in held if by > -AS_MUCH)


def _held_against_names(job: AdjustedJob, selection: Selection) -> Iterator[tuple[float, Unit, list[Chosen]]]:
    """Yield ln of the odds of the noise of each unit, the unit, and the names and wrong readings that it stands for."""
    test_set, system = selection.test_set, selection.test_set.system
    units = list(_units(job, system)) if selection.named else []
    for key, name, rows in units:
        own = [one for one in selection.named if selection.alternative(one).where.get(key) == name]
        if rows.sum() > _MOST_ROWS * sum(one.columns.shape[1] for one in own):
            continue
        own += [one for one in selection.outliers if test_set.keys_of(one.number).get(key) == name]
        bare = selection.fitted(without=own)
        unit = np.zeros((system.rows, int(rows.sum())))
        unit[rows, np.arange(unit.shape[1])] = 1.0
        scatter = RestrictedLikelihood.beside(bare, system.seen(unit))
        log_ratio, ratio, choice = scatter.best(), _ratio(system, bare, rows), float(np.log(len(units)))
        ahead = scatter.gain(log_ratio) - float(np.log(bare.dof)) / 2 - choice
        ahead -= evidence_of(selection, own, bare, selection.fitted())
        if ratio > APART:
            yield ahead, Unit(key, name, ratio, scatter.log_level(log_ratio) + choice), own


def moments_of_share(dof: float, first: float, second: float) -> tuple[float, float]:
    """Return mean and variance of the share of some rows in the squares of projected white noise.

    The residual `r = M z` has a direction that is uniform in `dof` dimensions, where the rows E have the quadratic form
    `A = MEM`. The share then has the mean `tr A / dof` and the variance `2 (dof tr A^2 - (tr A)^2) / (dof^2 (dof + 2))`
    (moments of a ratio of quadratic forms, Pitman 1937). `first` is `tr A`, `second` is `tr A^2`.
    """
    variance = 2 * max(dof * second - first**2, 0.0) / (dof**2 * (dof + 2))
    return first / dof, variance


def _units(job: AdjustedJob, system: System) -> Iterator[tuple[str, str, Mask]]:
    yield from (unit for unit in _parts(job, system) if unit[0] not in job.even)


def _parts(job: AdjustedJob, system: System) -> Iterator[tuple[str, str, Mask]]:
    for key in job.units:
        place = job.model.places[key]
        for name in place.names:
            rows = system.rows_at({key: name})
            if rows.any():
                yield key, name, rows
    for name, rows in system.of_several_groups():
        yield READING, name, rows
    for group in job.model.groups:
        if group.name not in job.model.measured and group.observations.count >= FEWEST:
            yield DECLARED_SIGMA, group.name, system.rows_of(group)


def log_tail_of_share(share: float, mean: float, variance: float) -> float:
    """Return ln of twice the smaller tail of a share whose null distribution is the beta distribution of its moments.

    The beta distribution is exact where all of the unit's residuals are seen alike (Henshaw 1966 for such ratios).
    """
    from scipy.special import betainc, betaincc

    spread = max(mean * (1 - mean) / max(variance, 1e-300) - 1, 1e-12)
    a, b = mean * spread, (1 - mean) * spread
    tail = min(float(betainc(a, b, share)), float(betaincc(a, b, share)))
    return float(np.log(max(2 * tail, 1e-300)))


def _log_without(system: System, fitted: FittedColumns, rows: Mask) -> float:
    """Return ln of the level of the F test of the prior values in some rows, `F = ((S - S_0)/q) / (S_0/nu_0)`.

    S_0 is the sum of squares without these values. Readings that contradict them increase the residuals of both, so the
    score test alone would miss it.
    """
    unit = np.zeros((system.rows, int(rows.sum())))
    unit[rows, np.arange(unit.shape[1])] = 1.0
    without = fitted.with_columns(system.seen(unit))
    q = fitted.dof - without.dof
    if q < 1 or without.dof < 1:
        return 0.0
    share = np.array(np.clip(1 - without.squares / max(fitted.squares, 1e-300), 0.0, 1.0))
    return float(log_tail(share, q, without.dof))


def _ratio(system: System, fitted: FittedColumns, rows: Mask, without: Mask | bool = False) -> float:
    """Return the standard deviation of some readings relative to the others without some, from expected squares."""
    taken, parts = system.basis.with_shared(fitted.basis), (rows, ~(rows | without))
    grams = [taken.part(part) for part in parts]
    h = np.array([[a.product(b) for b in grams] for a in grams])
    for i, part in enumerate(parts):
        h[i, i] += part.sum() - 2 * grams[i].trace
    squares = np.array([_squares(fitted, part) for part in parts])
    variance = np.linalg.lstsq(h, squares, rcond=None)[0]
    # a variance may come out negative: it is held above a fraction of the larger one
    floor = 1e-4 * max(float(variance.max()), 1e-300)
    return float(np.sqrt(max(variance[0], floor) / max(variance[1], floor)))


def reweighted(job: AdjustedJob, weights: Mapping[str, Array], unit: Unit) -> dict[str, Array]:
    """Return factors on the whitened readings of each group that bring the noise of a unit to that of the others."""
    if unit.key in (DECLARED_SIGMA, READING):
        return {**weights, unit.name: weights.get(unit.name, np.ones(1)) / unit.ratio * _ones(job, unit.name)}
    place = job.model.places[unit.key]
    number = place.names.index(unit.name)
    found = dict(weights)
    for group in job.model.readings:
        factor = weights.get(group.name, np.ones(group.observations.count)).copy()
        index = group.observations.index.get(place.index)
        if index is not None:
            factor[index == number] /= unit.ratio
        found[group.name] = factor
    return found


def _ones(job: AdjustedJob, group: str) -> Array:
    return np.ones(next(one.observations.count for one in job.model.groups if one.name == group))
