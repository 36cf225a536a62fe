"""Score tests: the F test of every candidate beside what the model contains, at a level corrected for multiple tests.

A scan over m places takes the smallest p-value of m dependent tests. Simulated white noise, projected like the
residuals, gives the effective number of independent tests. The same noise gives the effective number of independent
causes (Westfall and Young).

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.adjusted_job import Budget
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.columns import INSIDE, Remembered, lies_in
from metrocli.diagnosis.linear.distributions import log_family, log_levels
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, Left, orthonormal
from metrocli.diagnosis.linear.projection import VISIBLE, System
from metrocli.diagnosis.linear.quadratics import quadratic, quadratic_of
from metrocli.frozen import dataclass

_MOST_RANKED = 1000
"""Readings that are tested as outliers, those with the largest gains"""
_ROUNDING = 1e-9
"""Relative difference of levels (ln) that is rounding: a jump at two times without a reading between is one"""


@dataclass(frozen=True)
class Score:
    """The tests of one family."""

    gain: Array
    """Reduction of the sum of squares by each alternative"""
    rank: Array
    """Number of visible parameters of each alternative, 0 if it is not visible"""
    log_p: Array
    """ln of the p-value of each alternative as a single test"""

    @property
    def best(self) -> int:
        """The alternative with the smallest p-value; the first of those that differ by rounding only."""
        least = float(self.log_p.min())
        return int(np.argmax(self.log_p <= least + _ROUNDING * abs(least)))


@dataclass(frozen=True)
class ScoreTests:
    """All candidates, with the effective number of independent tests of each family and of all families together."""

    system: System
    families: tuple[Family, ...]
    blocks: Array
    """Diagonal block of M for each reading, (readings, d, d); 0 for components that it does not have"""
    places: Index
    """Rows of each reading, (readings, d), -1 if it has fewer components"""
    tests: tuple[float, ...] = ()
    """Effective number of tests of each family, then of the outliers"""
    causes: float = 1.0
    """Effective number of all families of effects together"""
    unknowns: float = 1.0
    """Effective number of all families of smooth functions together"""
    excluded: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Readings that cannot be named outliers"""
    adjusted: frozenset[tuple[str, tuple[str, ...]]] = frozenset()
    """Cause and place of the effects with which the unknowns were adjusted; these do not stop the selection"""
    throughout: tuple[Family, ...] = ()
    """Effects that are sought at all their places at once only"""
    budget: Budget = field(default_factory=Budget)
    """CPU time for a search"""
    remembered: Remembered = field(default_factory=Remembered, compare=False, repr=False)

    def alternative(self, family: int, number: int) -> Alternative:
        """Return an alternative of a family."""
        return self.families[family].alternatives[number]

    def place_of(self, other: Alternative, parameters: int) -> tuple[int, int] | None:
        """Return family and number here of an alternative of other tests, with the nearest scanned values, or None."""
        found = [
            (one.far_from(other), i, at)
            for i, family in enumerate(self.families)
            if family.columns.parameters == parameters
            for at, one in enumerate(family.alternatives)
            if one.like(other)
        ]
        return min(found)[1:] if found else None

    def counted_as(self, other: ScoreTests) -> ScoreTests | None:
        """Return these tests with the effective numbers of others of the same families; None if some are missing there.

        If only the smooth functions are the same, the outliers are one family more beside them.
        """
        known = {family.form: count for family, count in zip(other.families, other.tests, strict=False)}
        forms = [family.form for family in self.families]
        if not set(forms) <= set(known) or len(self.places) != len(other.places):
            return None
        causes = other.causes if len(forms) == len(known) else other.unknowns + 1
        return replace(
            self, tests=(*(known[form] for form in forms), other.tests[-1]), causes=causes, unknowns=other.unknowns
        )

    @cached_property
    def along_shared(self) -> tuple[Array, ...]:
        """Products of each family's columns with the shared columns, (alternatives, q, k)."""
        return tuple(one.columns.products(self.system.basis.shared) for one in self.families)

    @cached_property
    def along_residual(self) -> tuple[Array, ...]:
        """Products of each family's columns with the residual, (alternatives, q)."""
        right = self.system.residual[:, None]
        return tuple(one.columns.products(right)[:, :, 0] for one in self.families)

    def scores(self, fitted: FittedColumns) -> list[Score]:
        """Return the tests of all families beside the fitted columns."""
        return [self.score(number, fitted) for number in range(len(self.families))]

    def score(self, number: int, fitted: FittedColumns, chosen: Sequence[int] | None = None) -> Score:
        """Return the tests of one family beside the fitted columns; `chosen` limits them to some alternatives."""
        left, scale = self.left(number, fitted, chosen), self.families[number].raw
        gain, rank = quadratic(left.gram, left.right, scale if chosen is None else scale[list(chosen)])
        return self._scored(gain, rank, fitted)

    def left(self, number: int, fitted: FittedColumns, chosen: Sequence[int] | None = None) -> Left:
        """Return what a fit leaves of a family, or of some of its alternatives.

        It follows from what the start of the fit leaves, by the products with the columns that were fitted since.
        """
        family = self.families[number]
        key, parts = (number, family.columns.count), fitted.parts
        if key in fitted.known.families:
            left = fitted.known.families[key]
            return left if chosen is None else left.of(chosen)
        if parts is None:
            if fitted.residual is self.system.residual:
                left = Left(family.gram, self.along_residual[number])
                left = left if chosen is None else left.of(chosen)
            else:
                gram = family.gram if chosen is None else family.gram[list(chosen)]
                left = Left(gram, family.columns.products(fitted.residual[:, None], chosen)[:, :, 0])
            if fitted.width:
                along = family.columns.products(fitted.basis, chosen)
                left = left.with_columns(along, np.zeros(along.shape[2]))
        else:
            if chosen is None:
                along = parts.along(key, family.columns)
            elif key in parts.products:
                along = parts.products[key][list(chosen)]
            else:
                along = family.columns.products(parts.basis, chosen)
            amounts = parts.amounts
            if fitted.turns is None:
                left = self.left(number, parts.start, chosen).with_columns(along, amounts)
            elif key in parts.products:
                # fewer directions are removed than stay
                gone = fitted.turns[1]
                left = self.left(number, parts.fitted, chosen).without_columns(along @ gone, gone.T @ amounts)
            else:
                turn = fitted.turns[0]
                left = self.left(number, parts.start, chosen).with_columns(along @ turn, turn.T @ amounts)
        if chosen is None:
            fitted.known.families[key] = left
        return left

    def _scored(self, gain: Array, rank: Array, fitted: FittedColumns) -> Score:
        return Score(gain, rank, log_levels(gain / max(fitted.squares, 1e-300), rank, fitted.dof))

    def outliers(self, fitted: FittedColumns, among: Mask | bool = True) -> Score:
        """Return the tests of single readings, each with all its components; of many, those of the largest gains."""
        gain, rank = self.gains_of_readings(fitted)
        rank = np.where(self.excluded | ~np.asarray(among), 0, rank)
        gain = np.where(rank > 0, gain, 0.0)
        if len(gain) > _MOST_RANKED:
            # the others are no outliers, so their levels are not computed
            rank = np.where(gain < np.partition(gain, -_MOST_RANKED)[-_MOST_RANKED], 0, rank)
        return self._scored(gain, rank, fitted)

    def gains_of_readings(self, fitted: FittedColumns) -> tuple[Array, Array]:
        """Return the reduction of the sum of squares by an error of each reading, and the rank of that error."""
        known, rows = fitted.known, self.places
        if known.gains is None:
            right = np.where(rows >= 0, fitted.residual[rows], 0.0)
            known.gains = quadratic(self._left_of_readings(fitted), right, np.ones(rows.shape))
        return known.gains

    def _left_of_readings(self, fitted: FittedColumns) -> Array:
        """Return the Gram matrices of the readings' unit errors without the fitted columns, (readings, d, d)."""
        known, parts = fitted.known, fitted.parts
        if known.readings is None:
            if parts is None:
                known.readings = self.blocks - self._of_readings(fitted.basis)
            elif fitted.turns is None:
                known.readings = self._left_of_readings(parts.start) - self._of_readings(parts.basis)
            else:
                removed = self._of_readings(parts.basis @ fitted.turns[1])
                known.readings = self._left_of_readings(parts.fitted) + removed
        return known.readings

    def _of_readings(self, basis: Array) -> Array:
        u = np.where((self.places >= 0)[:, :, None], basis[self.places], 0.0)
        return np.asarray(np.einsum("iak,ibk->iab", u, u))

    def lying_in(self, family: int, number: int) -> tuple[Mask, ...]:
        """Return for each family which of its alternatives lie in smooth terms; False for smooth functions."""
        key = family, number
        if key not in self.remembered.lying_in:
            basis = _unit(self.visible(family, number))
            self.remembered.lying_in[key] = tuple(
                np.zeros(len(f.alternatives), dtype=bool) if f.unknown else lies_in(f.columns, f.gram, basis)
                for f in self.families
            )
        return self.remembered.lying_in[key]

    def around(self, family: int, number: int) -> list[tuple[int, int]]:
        """Return the smooth terms in which an effect lies, each by its family and number."""
        if self.families[family].unknown:
            return []
        effect = self.visible(family, number)
        least = INSIDE * float((effect**2).sum())
        found = []
        for i, smooth in enumerate(self.families):
            if smooth.unknown:
                inside, _ = quadratic_of(smooth.gram, smooth.columns.products(effect), smooth.raw)
                found += [(i, int(at)) for at in np.flatnonzero(inside > least)]
        return found

    def causes_in(self, smooth: Sequence[tuple[int, int]]) -> float:
        """Return the effective number of independent effects that lie in smooth terms, `n^2 / sum c_ij`.

        c_ij is the squared correlation of two effects, 1 for aliases (effective number of tests, Nyholt 2004).
        """
        lying = {i: int(np.argmax(m)) for one in smooth for i, m in enumerate(self.lying_in(*one)) if m.any()}
        # an effect that hardly shows can round to no column
        bases = [basis for i, at in lying.items() if (basis := _unit(self.visible(i, at))).shape[1]]
        alike = [[((a.T @ b) ** 2).sum() / min(a.shape[1], b.shape[1]) for b in bases] for a in bases]
        return len(bases) ** 2 / float(np.sum(alike)) if bases else 1.0

    def visible(self, family: int, number: int) -> Array:
        """Return the visible columns of an alternative, (rows, parameters)."""
        return self.remembered.columns((family, number), lambda: self.system.seen(self.whole(family, number)))

    def level(self, number: int, log_p: float) -> float:
        """Return ln of the p-value of a family's best alternative, corrected for the tests of the family."""
        return float(log_family(log_p, self.tests[number]))

    def overall(self, log_level: float) -> float:
        """Return ln of the p-value of the best family, corrected for all families."""
        return float(log_family(log_level, self.causes))

    def whole(self, family: int, number: int) -> Array:
        """Return the whole columns of an alternative, (rows, parameters)."""
        return self.families[family].columns.whole([number], self.system.rows)[:, 0]

    def changed_by(self, family: int, number: int) -> Mask:
        """Return which readings an alternative changes."""
        whole = self.whole(family, number)
        return np.asarray(((whole != 0).any(axis=1)[self.places] & (self.places >= 0)).any(axis=1))

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

    def of_reading(self, reading: int) -> Array:
        """Return the visible columns of an error of one reading, (rows, d)."""
        return self.remembered.columns((-1, reading), lambda: self._of_reading(reading))

    def _of_reading(self, reading: int) -> Array:
        rows = self.places[reading][self.places[reading] >= 0]
        unit = np.zeros((self.system.rows, len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        return self.system.seen(unit)


def _unit(columns: Array) -> Array:
    """Return an orthonormal basis of columns (rows, q)."""
    return orthonormal(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), VISIBLE)
