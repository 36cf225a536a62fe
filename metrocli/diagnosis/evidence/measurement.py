"""A job linearised about a solution, with all that can explain its residuals.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.functions import Functions
from metrocli.diagnosis.evidence.parts import (
    CORRELATED,
    EFFECT,
    LARGEST,
    READING,
    READINGS,
    SCATTER,
    TERM,
    TERMS,
    UNKNOWN,
    Fixed,
    Random,
    fixed,
)
from metrocli.diagnosis.evidence.prices import OF_ALL, OF_UNITS, PRIOR, Prices, price_of_variance
from metrocli.diagnosis.linear.basis import Columns, thin
from metrocli.diagnosis.linear.candidates import Candidate, CandidateGroup, NotTested
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.effects.covariates import kernel, least_length
from metrocli.frozen import dataclass

LENGTHS = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)
"""Lengths of correlation that are tried, as shares of the largest range of a unit: what is slower is a drift"""
_SMOOTH = 1e-4
"""Share of the squares of its largest direction below which a direction of a smooth effect is left out"""
_MOST_DENSE = 3_000_000
"""Numbers of the columns of a family that are held as one table"""


@dataclass(frozen=True)
class Measurement:
    """A job linearised about a solution, with all that can explain its residuals."""

    job: AdjustedJob
    system: Linearised
    families: tuple[CandidateGroup, ...]
    """Candidates: the effects at their places"""
    not_tested: list[NotTested]
    scatters: tuple[tuple[CandidateGroup, ...], ...]
    """Families of each effect that may act at all its places at once"""
    knots: tuple[Functions, ...]
    """Functions of the covariates with which errors may be correlated"""
    places: Index
    """Rows of each reading, (readings, d), -1 if it has fewer components"""
    units: tuple[tuple[str, str, Mask], ...]
    """Variance groups: kind, name and rows"""
    prices: Prices
    noise: Mapping[int, float] = field(default_factory=dict)
    """Noise of variance groups relative to the declared one, by their number, where it is not 1"""
    log_scale: float = 0.0
    """ln of the determinants by which their weights change the likelihood"""
    unweighted: Measurement | None = None
    """The measurement with the declared noise of all readings; None if it is this one"""
    cache: dict[object, Array] = field(default_factory=dict, compare=False, repr=False)
    """Cache of products"""
    columns: dict[object, Array] = field(default_factory=dict, compare=False, repr=False)
    """Columns of parts without what unknowns absorb; those that were asked for last are held"""

    @cached_property
    def squares(self) -> float:
        """Squares of the residual, with those that the declared noise counts for."""
        r = float(self.system.residual @ self.system.residual)
        # at most 1: where the noise is larger than declared, the declared one counts; a smaller one counts as found
        return r + PRIOR * min(1.0, r / max(self.system.dof, 1))

    @cached_property
    def dof(self) -> float:
        """Degrees of freedom, with those that the declared noise counts for."""
        return self.system.dof + PRIOR

    @property
    def weights(self) -> Array:
        """Factors of the rows for the noise of variance groups, (rows,): 1 where it is the declared one."""
        factors = np.ones(self.system.rows)
        for number, ratio in self.noise.items():
            factors[self.units[number][2]] /= ratio
        return factors

    @cached_property
    def folds(self) -> Index:
        """The number of the fold of each row, (rows,): -1 for priors but those of a random effect of a member."""
        system, basis = self.system, self.system.basis
        rows = np.full(system.rows, -1, dtype=np.intp)
        for group in self.job.model.readings:
            # counted from 1, so that 0 stays for the rows of priors
            fold = system.spread(group, self.job.folds[group.name].astype(float) + 1)
            rows = np.where(fold > 0, fold.astype(np.intp) - 1, rows)
        own = np.full(basis.members + 1, -1, dtype=np.intp)  # the last is that of rows without a member
        read = (rows >= 0) & (basis.member >= 0)
        own[basis.member[read]] = rows[read]
        # a member whose readings lie in several folds belongs to none of them, since
        # its last fold has overwritten the others
        own[basis.member[read][own[basis.member[read]] != rows[read]]] = -1
        random = {f"prior of {added.block}" for added in self.job.model.added if added.std}
        for group in (group for group in self.job.model.groups if group.name in random):
            at = system.rows_of(group)
            rows[at] = own[basis.member[at]]
        return rows

    @property
    def fold_numbers(self) -> list[int]:
        """The numbers of the folds."""
        return sorted({*self.folds.tolist()} - {-1})

    @cached_property
    def rows_of_members(self) -> list[Index]:
        """Rows of each local member."""
        member, members = self.system.basis.member, self.system.basis.members
        order = np.argsort(member, kind="stable")
        return np.split(order, np.searchsorted(member[order], np.arange(members + 1)))[1:-1]

    def is_local(self, knots: Functions) -> bool:
        """Whether each unit of a covariate is alone in one local member, so that its errors are eliminated with it."""
        member, there = self.system.basis.member, knots.component >= 0
        if not knots.by or self.system.basis.members < 2 or (member[there] < 0).any():
            return False
        # each has one of the other: images of several cameras share the pose of their exposure
        return _is_function(knots.unit[there], member[there]) and _is_function(member[there], knots.unit[there])

    @cached_property
    def local(self) -> tuple[bool, ...]:
        """Of each covariate, whether its units are alone in one local member each."""
        return tuple(map(self.is_local, self.knots))

    def lengths(self, number: int) -> list[float]:
        """Return the lengths of correlation that the knots of a covariate resolve."""
        least = least_length(self.knots[number].distances)
        return [length for length in LENGTHS if length >= least]

    def kernel(self, number: int, length: float) -> Array:
        """Return the root of the covariance between the knots of a covariate."""
        key = "kernel", number, length
        if key not in self.cache:
            self.cache[key] = kernel(self.knots[number].distances, length)
        return self.cache[key]

    @cached_property
    def tried(self) -> float:
        """Number of correlated errors that are tried: covariates and lengths, of which neighbours are alike."""
        return max(sum(len(self.lengths(i)) for i in range(len(self.knots))) / 3, 1.0)

    def price_of_correlated(self, number: int, unit: int) -> float:
        """Return the price of an error correlated over a covariate, of all units together or of one of them."""
        own = self.knots[number]
        copies = own.count if unit >= 0 else 1
        each = bool(own.by) and unit < 0
        return price_of_variance(self.tried * copies) + (OF_UNITS if each else OF_ALL)

    @property
    def price_of_scatter(self) -> float:
        """The price of an effect at all its places: a name too, one of the causes that share the level."""
        return price_of_variance(self.prices.causes)

    @property
    def price_of_noise(self) -> float:
        """The price of a variance group of its own."""
        return price_of_variance(len(self.units))

    def alternative(self, key: tuple[int, int]) -> Candidate:
        """Return an alternative by its family and number."""
        return self.families[key[0]].alternatives[key[1]]

    def whole(self, family: int, number: int) -> Array:
        """Return the whole columns of an alternative, (rows, parameters)."""
        return self.families[family].columns.whole([number], self.system.rows)[:, 0]

    @cached_property
    def side_by_side(self) -> tuple[Columns, dict[int, slice]]:
        """Whole columns of the families that are small enough, (rows, columns), and where those of each are."""
        rows, most = self.system.rows, _MOST_DENSE // self.system.rows
        parts, at, end = [np.zeros((rows, 0))], dict[int, slice](), 0
        for family, group in enumerate(self.families):
            size = group.columns.count * group.columns.parameters
            if end + size <= most:
                parts.append(group.columns.whole(range(group.columns.count), rows).reshape(rows, -1))
                at[family] = slice(end, end + size)
                end += size
        return thin(np.concatenate(parts, axis=1)), at

    @cached_property
    def cache_of_families(self) -> dict[object, Array]:
        """Cache of products with its families; a measurement with other families shares `cache`, not this."""
        return {}

    def grams_beside_members(self, family: int) -> Array:
        """Return the Gram matrices of a family beside the local unknowns, (alternatives, parameters, parameters)."""
        cache, key = self.cache_of_families, ("grams", family)
        if key not in cache:
            cache[key] = self.families[family].columns.grams(self.system.basis.of_members)
        return cache[key]

    def refuting(self, effects: Collection[tuple[str, tuple[str, ...]]]) -> Measurement:
        """Return the measurement in which nothing names some effects, by cause and place, any more."""
        masks = [np.array([one.spot in effects for one in family.alternatives]) for family in self.families]
        refuted = {number: mask for number, mask in enumerate(masks) if mask.any()}
        prices = replace(self.prices, refuted=refuted)
        bare = self.unweighted and replace(self.unweighted, prices=prices)
        return replace(self, prices=prices, unweighted=bare)

    def effect(self, family: int, number: int) -> Fixed:
        """Return an effect at a place as fixed columns."""
        whole = self.whole(family, number)
        unknown = bool(self.families[family].unknown)
        gram = self.families[family].gram[number]
        effect = fixed(whole, gram, (family, number), 0.0, UNKNOWN if unknown else EFFECT)
        return replace(effect, price=self.prices.of_columns(family, max(effect.rank, 1)) + (OF_ALL if unknown else 0.0))

    def term(self, whole: Array, key: tuple[int, int], price: float) -> Fixed:
        """Return the whole columns of a term of a law (rows, factors) as fixed columns, whose key no effect has."""
        seen = self.system.seen(whole)
        return fixed(whole, seen.T @ seen, (TERMS - key[0], key[1]), price, TERM)

    def rows_of(self, reading: int) -> Index:
        """Return the rows of a reading that may be wrong, (d,)."""
        rows: Index = self.places[reading]
        return rows[rows >= 0]

    def reading(self, number: int) -> Fixed:
        """Return the error of one reading as fixed columns."""
        rows = self.rows_of(number)
        whole = np.zeros((self.system.rows, len(rows)))
        whole[rows, np.arange(len(rows))] = 1.0
        gram = np.eye(len(rows)) - self.system.basis.products(rows, rows)
        error = fixed(whole, gram, (READINGS, number), 0.0, READING)
        return replace(error, price=self.prices.of_columns(READINGS, max(error.rank, 1)))

    def correlation(self, first: Fixed, other: Fixed) -> Array:
        """Return the products of what is visible of the errors of two readings, whose columns have the length 1."""
        some, others = self.rows_of(first.number), self.rows_of(other.number)
        same = (some[:, None] == others).astype(float)
        return np.asarray(first.turn.T @ (same - self.system.basis.products(some, others)) @ other.turn)

    def random(self, kind: str, key: tuple[int, int, int]) -> Random:
        """Return a random part by its kind and key."""
        return self.scatter(key[0]) if kind == SCATTER else self.correlated(key[0], LENGTHS[key[1]], key[2])

    def correlated(self, number: int, length: float, unit: int) -> Random:
        """Return an error that is correlated over a covariate."""
        key, turn = (number, LENGTHS.index(length), unit), self.kernel(number, length)
        local = self.local[number] and unit < 0
        own = self.knots[number]
        columns = own.compact(turn, unit) if local or unit >= 0 else own.spread(turn)
        price = self.price_of_correlated(number, unit)
        return Random(CORRELATED, key, columns, local, price, LARGEST)

    def scatter(self, number: int) -> Random:
        """Return an effect at all its places, with sizes of one variance in the unit of its parameters."""
        if self.unweighted is not None:
            # which directions are too small to see is not asked anew: a state keeps its columns under other weights
            own = self.unweighted.scatter(number)
            return replace(own, columns=own.columns * self.weights[:, None])
        rows = self.system.rows
        columns = [scatter.columns.whole(range(scatter.columns.count), rows) for scatter in self.scatters[number]]
        every = np.concatenate([column.reshape(rows, -1) for column in columns], axis=1)
        if self.scatters[number][0].effect.is_smooth:
            # a turn of the coefficients leaves them independent; most directions of a smooth shape are too small to see
            values, vectors = np.linalg.eigh(every.T @ every)
            every = every @ vectors[:, values > _SMOOTH * values[-1]]
        else:
            # what the unknowns absorb wholly shows in no likelihood
            every = every[:, np.concatenate([family.shown.ravel() for family in self.scatters[number]])]
        norms = np.linalg.norm(every, axis=0)
        typical = float(np.median(norms[norms > 0])) if norms.any() else 1.0
        # divided by the typical length, so that ln of its variance starts near 0; `unit` brings the size back
        return Random(SCATTER, (number, 0, -1), every / typical, False, self.price_of_scatter, 30.0, 1 / typical)

    def keys_of(self, reading: int) -> dict[str, str]:
        """Return the keys that identify a reading, with its component if the components are tested one by one."""
        row, first = int(self.places[reading][0]), self.system.first
        groups = self.system.model.readings
        group = next(g for g in groups if 0 <= row - first[g.name] < g.observations.readings.size)
        observations = group.observations
        at, component = divmod(row - first[group.name], len(observations.readings))
        keys = {key: values[at] for key, values in observations.keys.items()}
        single = len(observations.readings) > 1 and self.places.shape[1] == 1
        return keys | ({"component": observations.components[component]} if single else {})


def _is_function(numbers: Index, values: Index) -> bool:
    """Return whether equal numbers (n,) have equal values (n,)."""
    of_each = np.zeros(int(numbers.max(initial=0)) + 1, dtype=np.intp)
    of_each[numbers] = values
    return bool((of_each[numbers] == values).all())
