"""Parts that explain the residuals at their likeliest sizes, with their score.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import compress
from typing import Any, Self, cast

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.evidence.likelihood import Fit, Products, fit_at, likeliest
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import EFFECT, TERMS, UNKNOWN, Fixed, Random
from metrocli.diagnosis.evidence.prices import FURTHER, PRIOR, gain_of_columns
from metrocli.diagnosis.evidence.products import products_of
from metrocli.diagnosis.linear.quadratics import solved
from metrocli.frozen import dataclass

_EXACT, _EXACT_OF_ALL = 1e-10, 1e-15
"""Variance of rounding, in the declared one and in that before anything was named"""
TRIAL = 2
"""Steps of the sizes in a trial"""


@dataclass(frozen=True)
class Scored:
    """Parts that explain the residuals of a measurement, at the likeliest sizes."""

    measurement: Measurement
    fixed: tuple[Fixed, ...]
    random: tuple[Random, ...]
    fit: Fit
    cache: dict[object, Any] = field(default_factory=dict, compare=False, repr=False)
    """Cache of what is left of families"""

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        fixed: Sequence[Fixed] = (),
        random: Sequence[Random] = (),
        logs: Sequence[float] | Array = (),
        steps: int = 12,
        known: Products | None = None,
    ) -> Self:
        """Return a state, its sizes estimated from some on; `known` are the products of some of its parts."""
        products = products_of(measurement, fixed, random, known=known)
        most = np.array([part.most for part in random])
        fit = fit_at(products, np.minimum(np.array(logs, dtype=float), most))
        return cls(measurement, tuple(fixed), tuple(random), likeliest(fit, most, steps))

    @property
    def logs(self) -> Array:
        """ln of the variance of each random part, in that of the noise."""
        return self.fit.logs

    @property
    def named(self) -> tuple[Fixed, ...]:
        """The identified effects."""
        return tuple(part for part in self.fixed if part.sort == EFFECT)

    @property
    def unknown(self) -> tuple[Fixed, ...]:
        """What varies with a covariate for a cause that is not known."""
        return tuple(part for part in self.fixed if part.sort == UNKNOWN)

    @property
    def readings(self) -> tuple[Fixed, ...]:
        """The wrong readings."""
        return tuple(part for part in self.fixed if part.is_reading)

    @cached_property
    def bare_squares(self) -> float:
        """Squares of the residual that unknowns and random parts leave."""
        sought = self.fit.sought[self.fit.fixed :]
        return float(self.fit.squares + sought @ sought)

    @cached_property
    def freedoms(self) -> float:
        """Degrees of freedom beside all fixed columns."""
        return float(self.fit.dof - sum(part.rank for part in self.fixed))

    @cached_property
    def noise_freedoms(self) -> float:
        """Degrees of freedom of the white noise alone: without those of the declared one and of the random parts."""
        return self.freedoms - PRIOR - float(self.fit.slopes[1].sum())

    @property
    def variance(self) -> float:
        """Variance of the noise, in that declared."""
        return float(self.fit.squares / max(self.freedoms, 1.0))

    @property
    def is_exact(self) -> bool:
        """Whether what it leaves is the rounding of numbers, in which there is nothing to find."""
        m = self.measurement
        return self.variance < max(_EXACT, _EXACT_OF_ALL * m.squares / m.dof)

    @cached_property
    def score(self) -> float:
        """The restricted log-likelihood with the evidence of the fixed parts, less the prices of all parts."""
        return float(self._scores(np.ones((1, len(self.fixed)), dtype=bool))[0])

    def _scores(self, kept: Mask) -> Array:
        """Return the scores with some of the fixed parts (n, parts), at the same sizes of the random parts."""
        likelihood = self.measurement.log_scale - (self.fit.dof * np.log(self.bare_squares) + self.fit.log_det) / 2
        prices = [self._prices([*compress(self.fixed, choice)]) for choice in kept]
        return np.asarray(likelihood + self._evidence(kept) - prices)

    def _evidence(self, kept: Mask) -> Array:
        """Return the sum of the evidence of some fixed parts, each beside those before it, for choices (n, parts)."""
        of_each, at = [part.rank for part in self.fixed], self.fit.fixed
        # the last rows of the factor of the whole system are the factor of what is left beside all before them
        lower, sought = self.fit.lower[at:, at:], self.fit.sought[at:]
        gram, right = lower @ lower.T, lower @ sought
        own, ranks = np.repeat(kept, of_each, axis=1), np.where(kept, np.array(of_each, dtype=float), 0.0)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        # the bump lets a column that depends on others pass; its diagonal shows below that it did
        unit, right = gram / scale / scale[:, None] + 1e-12 * np.eye(len(scale)), right / scale
        explained = np.zeros(own.shape)
        for some, squares in zip(map(np.flatnonzero, own), explained, strict=True):
            lower = np.asarray(np.linalg.cholesky(unit[some[:, None], some]), dtype=float)
            # a column that depends on those before it explains nothing
            squares[some] = np.where(np.diag(lower) > 1e-5, solved(lower, right[some]) ** 2, 0.0)
        ends = np.cumsum([0, *of_each])
        after = np.cumsum(np.pad(explained, ((0, 0), (1, 0))), axis=1)[:, ends]
        left = np.maximum(self.bare_squares - after[:, :-1], 1e-300)
        free = self.fit.dof - np.cumsum(ranks, axis=1, dtype=float) + ranks
        return np.asarray(gain_of_columns(np.diff(after), ranks, left, free).sum(axis=1))

    def _prices(self, fixed: Sequence[Fixed]) -> float:
        names = sum(part.sort == EFFECT for part in fixed)
        # the first name pays nothing further, unless wrong readings have been named before it
        alone = all(not part.is_reading for part in fixed)
        further = FURTHER * max(names - alone, 0)
        noise = len(self.measurement.noise) * self.measurement.price_of_noise
        return noise + further + sum(part.price for part in fixed) + sum(part.price for part in self.random)

    def without_fixed(self) -> Array:
        """Return what each fixed part adds to the score, at the same sizes of the random parts."""
        return np.asarray(self.score - self._scores(~np.eye(len(self.fixed), dtype=bool)))

    def plus(
        self, fixed: Sequence[Fixed] = (), random: Sequence[Random] = (), logs: Sequence[float] = (), steps: int = TRIAL
    ) -> Self:
        """Return the state with further parts, all sizes estimated anew."""
        every = (*self.random, *random)
        return type(self).of(
            self.measurement, (*self.fixed, *fixed), every, (*self.logs, *logs), steps, self.fit.products
        )

    def minus(self, parts: Sequence[Fixed | Random]) -> Self:
        """Return the state without some parts, all sizes estimated anew, computed once."""
        gone = {id(part) for part in parts}
        # the state holds its parts, so that their identities stay theirs
        if (key := ("minus", frozenset(gone))) not in self.cache:
            kept = [j for j, part in enumerate(self.random) if id(part) not in gone]
            fixed = [part for part in self.fixed if id(part) not in gone]
            random, known = [self.random[j] for j in kept], self.fit.products
            self.cache[key] = (
                self.keeping(fixed).again(TRIAL)
                if len(kept) == len(self.random)
                else type(self).of(self.measurement, fixed, random, self.logs[kept], TRIAL, known)
            )
        # without what it may come to hold of candidates and rows
        return replace(cast("Self", self.cache[key]), cache={})

    def again(self, steps: int = 12) -> Self:
        """Return the state with all sizes estimated anew from these on."""
        return replace(self, fit=likeliest(self.fit, np.array([part.most for part in self.random]), steps), cache={})

    def keeping(self, fixed: Iterable[Fixed]) -> Self:
        """Return the state with some of its fixed parts, at the same sizes of the random parts."""
        ids = {id(part) for part in fixed}
        kept = [j for j, part in enumerate(self.fixed) if id(part) in ids]
        fit = self.fit.keeping(kept, len(self.fixed))
        return replace(self, fixed=tuple(self.fixed[j] for j in kept), fit=fit, cache={})

    def beside(self, part: Fixed) -> Self:
        """Return the state without a fixed part, at the same sizes of the random parts."""
        # sizes that were estimated again would take up what the part has explained
        return self.keeping(other for other in self.fixed if other is not part)

    def with_fixed(self, number: int, part: Fixed) -> Self:
        """Return the state with another fixed part in the place of one."""
        fixed = (*self.fixed[:number], part, *self.fixed[number + 1 :])
        return type(self).of(self.measurement, fixed, self.random, self.logs, TRIAL, self.fit.products)

    def at(self, measurement: Measurement, random: bool = True) -> Self:
        """Return the state of the same parts, or of the fixed ones, in the measurement with other weights."""
        fixed = [self._fixed_in(measurement, part) for part in self.fixed]
        if not random:
            return type(self).of(measurement, fixed)
        here, there = self.measurement, measurement
        # another linearisation has other columns; the same one with other weights has the old ones times a factor
        if (here.unweighted or here) is not (there.unweighted or there):
            return type(self).of(there, fixed, [there.random(part.kind, part.key) for part in self.random], self.logs)
        factor = (there.weights / here.weights)[:, None]
        return type(self).of(there, fixed, [replace(p, columns=p.columns * factor) for p in self.random], self.logs)

    def _fixed_in(self, measurement: Measurement, part: Fixed) -> Fixed:
        if part.is_reading:
            return measurement.reading(part.number)
        if part.family >= 0:
            return replace(measurement.effect(*part.key), aliases=part.aliases, rivals=part.rivals)
        # a term of a law is added last, when only weights change any more
        whole = part.columns * (measurement.weights / self.measurement.weights)[:, None]
        term = measurement.term(whole, (TERMS - part.family, part.number), part.price)
        return replace(term, turn=part.turn @ term.turn)

    def settled(self) -> Self:
        """Return the state with all sizes estimated until they stay."""
        return self.again() if self.random else self
