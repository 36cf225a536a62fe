"""Smooth processes: errors of the readings that vary smoothly with a covariate, by chance and not by a law.

Real measurements have structure that no cause explains: air that wavers, a mount that creeps. It has no form of its
own, so in a race against names with few parameters it loses, and the names are wrong. Its covariance is raced instead:
one amplitude, one length of correlation, independent in each tracer or image. Where it wins, it belongs to the noise.
Method: docs/algorithms/selection-and-levels.md (smooth processes).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.restricted_likelihood import RestrictedLikelihood, gain_of_larger_noise, log_level_of
from metrocli.diagnosis.selection.all_of_a_kind import AllOfAKind, log_level_beside
from metrocli.diagnosis.selection.backward_steps import evidence_of
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.diagnosis.smooth_errors.functions import Functions, process_bases
from metrocli.diagnosis.smooth_errors.process import Process
from metrocli.frozen import dataclass

_LENGTHS = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)
"""Lengths of correlation that are tried, as shares of the largest range of a unit: what is slower is a drift"""
_RESOLVED = 0.6
"""Least length of correlation, in distances of the knots"""
_GAIN = 2.0
"""Least gain of the log-likelihood by a process: a level of 2.3 % for one variance"""
_MORE, _FAR_MORE = 1.4, 3.5
"""ln of the odds by which names must exceed a process that stands for them; at one unit, where structure is left"""
_NOTICED, _MOST_TRIED = 1.5, 4
"""Least score of a variance, in its standard deviations, at which its likelihood is computed; and of how many"""
_SWEEPS, _APART = 2, 1.5
"""Rounds in which the units' own variances are estimated, and the expected standard deviation of their logarithms"""
_VISIBLE = 1e-3
"""Variance, relative to that of the noise, below which a direction of a process is left out"""


def process_in(job: AdjustedJob, selection: Selection) -> Process | None:
    """Return the process that belongs to the noise beside which the effects of a selection hold; None if none shows.

    It is estimated beside the named effects, and beside fewer and fewer of them, where it stands instead of the others.
    These with their counted choice are held against that by their evidence; the process of the largest likelihood
    beside them, which may be another, counts for them. Where structure is left beside the names, each unit has such an
    error anyhow. It can look like a name at that unit, which then must have far more evidence; it does not look the
    same in all units.
    """
    bases = list(process_bases(job, selection.test_set.system))
    named = selection.fitted(without=selection.unknown)
    without = list(_without_names(job, selection, named, _apart(job, bases)))
    # what stands for a name is tried beside it too, where its score need not be among the largest
    same = {(one.scored.basis.name, one.scored.basis.by, one.scored.length): one for one, _, _ in without}
    tried = (_best(bases, named), *(_beside(one, named) for one in same.values()))
    beside = max((one for one in tried if one is not None), key=lambda one: one.gain, default=None)
    left = 0.0 if beside is None else beside.gain
    odds = _FAR_MORE if left > _GAIN else _MORE
    ahead = [(one.gain - evidence - left + (0.0 if shared else odds), one) for one, evidence, shared in without]
    most, instead = max(ahead, key=lambda one: one[0], default=(0.0, beside))
    best = instead if most > 0 else beside
    return best.process(len(bases)) if best is not None and best.gain > _GAIN else None


def _without_names(
    job: AdjustedJob, selection: Selection, named: FittedColumns, apart: Sequence[Functions]
) -> Iterator[tuple[_Tried, float, bool]]:
    """Yield the process that shows without some names, the evidence of these, and whether they act in all units."""
    for gone in _weakest_first(selection, named):
        bare = selection.fitted(without=[*gone, *selection.unknown])
        found = _best(apart, bare)
        if found is not None and found.gain > _GAIN:
            shared = all(_is_shared(job, selection.alternative(one)) for one in gone)
            yield found, evidence_of(selection, gone, bare, named), shared


def stands_for(job: AdjustedJob, selection: Selection, scatter: AllOfAKind) -> bool:
    """Whether a process explains more than an effect that scatters over all its places: both have one amplitude."""
    base = selection.fitted(without=selection.unknown)
    found = _best(_apart(job, process_bases(job, selection.test_set.system)), base)
    level = log_level_beside(base, selection.test_set, scatter.effect.name)
    return found is not None and log_level_of(found.gain) < level


def _apart(job: AdjustedJob, bases: Iterable[Functions]) -> list[Functions]:
    """Return those of each unit: an error that all units share is what effects such as the air are."""
    return [basis for basis in bases if basis.by or not job.units]


def _is_shared(job: AdjustedJob, name: Alternative) -> bool:
    """Whether an effect is the same in all units, where readings have units."""
    return bool(job.units) and not set(job.units) & set(name.effect.keys)


def _weakest_first(selection: Selection, named: FittedColumns) -> Iterator[tuple[Chosen, ...]]:
    """Yield the name with the least evidence beside the others, the two with the least, and so on."""

    def evidence(one: Chosen) -> float:
        return evidence_of(selection, [one], selection.fitted(without=[one, *selection.unknown]), named)

    ordered = sorted(selection.named, key=evidence)
    yield from (tuple(ordered[: count + 1]) for count in range(len(ordered)))


def _best(bases: Sequence[Functions], base: FittedColumns) -> _Tried | None:
    """Return the process of the largest likelihood beside a fit, of those with the largest scores; None without one."""
    scored = [one for basis in bases for one in _scored(basis, base)]
    noticed = sorted((one for one in scored if one.excess > _NOTICED), key=lambda one: -one.excess)
    return max((one.estimated() for one in noticed[:_MOST_TRIED]), key=lambda one: one.gain, default=None)


def _beside(process: _Tried, base: FittedColumns) -> _Tried:
    """Return a process beside another fit, with the variances of the largest likelihood there."""
    one = process.scored
    return next(other for other in _scored(one.basis, base) if other.length == one.length).estimated()


def _scored(basis: Functions, base: FittedColumns) -> Iterator[_Scored]:
    """Yield the processes of all lengths beside a fit."""
    knots = len(basis.distances)
    copies = basis.columns.shape[1] // knots
    along = basis.columns.T @ base.basis
    gram = basis.gram - along @ along.T
    right = (basis.columns.T @ base.residual).reshape(copies, knots)
    spacing = float(np.min(basis.distances, where=basis.distances > 0, initial=np.inf))
    for length in _LENGTHS:
        if length >= _RESOLVED * spacing:
            root = _root(basis.distances / length)
            turned = _turned(gram, np.stack([root] * copies))
            yield _Scored(basis, length, root, turned, (right @ root).ravel(), base)


def _turned(gram: Array, roots: Array) -> Array:
    """Return the Gram matrix of `H L` by that of H, with an L for each unit and component (copies, knots, knots)."""
    copies, knots = roots.shape[:2]
    for _ in range(2):
        gram = np.matmul(gram.T.reshape(-1, copies, 1, knots), roots)[:, :, 0].reshape(copies * knots, -1)
    return gram


def _root(distances: Array) -> Array:
    """Return L with `L L' = C`, the covariance `(1 + d) exp(-d)` of a process (Matern 3/2), at the knots."""
    d = np.sqrt(3) * distances
    return np.asarray(np.linalg.cholesky((1 + d) * np.exp(-d) + 1e-9 * np.eye(len(d))))


@dataclass(frozen=True)
class _Scored:
    """A process by the products of its columns `Z = H L` beside a fit, H being those of the knots."""

    basis: Functions
    length: float
    root: Array
    """L, (knots, knots)"""
    gram: Array
    """`Z'MZ`"""
    along: Array
    """`Z'v`"""
    base: FittedColumns

    @cached_property
    def excess(self) -> float:
        """The score of a variance at 0, `(y'y/s^2 - tr G) / sqrt(2 tr G^2)`: of all units and components, or of one."""
        knots = len(self.root)
        copies = len(self.gram) // knots
        each = np.arange(copies)
        grams = self.gram.reshape(copies, knots, copies, knots)[each, :, each]
        noise = self.base.dof / max(self.base.squares, 1e-300)
        squares = (self.along.reshape(copies, knots) ** 2).sum(axis=1) * noise - np.einsum("akk->a", grams)
        single = squares / np.sqrt(2 * np.maximum((grams**2).sum(axis=(1, 2)), 1e-300))
        every = squares.sum() / np.sqrt(2 * max(float((self.gram**2).sum()), 1e-300))
        return float(max(every, single.max()))

    def estimated(self) -> _Tried:
        """Return it with the variances of the largest likelihood."""
        likelihood = RestrictedLikelihood.of(self.base, self.gram, self.along)
        log_ratio = likelihood.best()
        return _Tried(self, likelihood, log_ratio, *self._of_each(log_ratio))

    def _of_each(self, common: float) -> tuple[Array, float]:
        """Return the ratio of variances of each unit and component, (copies,), and what its freedom costs.

        Each is the likeliest with the others held, in turn; ln of the ratio has the mean of the others as its
        expectation. The cost is that of Laplace's approximation to the integral over all ratios, `sum ln(1 + s^2 h)/2`
        with the bend h of the log-likelihood.
        """
        knots = len(self.root)
        logs = np.full(len(self.gram) // knots, common)
        bends = np.zeros(len(logs))
        if len(logs) == 1:
            return np.exp(logs), 0.0
        inverse = np.linalg.inv(self.gram + np.exp(-common) * np.eye(len(self.gram)))
        for copy in list(range(len(logs))) * _SWEEPS:
            # the Gram matrix beside the others is the inverse of the copy's block of (G + 1/g)^-1, less its own 1/g
            own = slice(copy * knots, (copy + 1) * knots)
            block, sizes = inverse[own, own], inverse @ self.along
            beside = np.linalg.inv(block)
            right = beside @ sizes[own]
            explained = float(self.along @ sizes - sizes[own] @ right)
            rest = replace(self.base, squares=self.base.squares - explained)
            left = RestrictedLikelihood.of(rest, beside - np.exp(-logs[copy]) * np.eye(knots), right)
            before = logs[copy]
            logs[copy], bends[copy] = left.best_near(float(np.delete(logs, copy).mean()), _APART)
            grown = float(np.exp(-logs[copy]) - np.exp(-before))
            gain = np.linalg.solve(np.eye(knots) + grown * block, grown * inverse[own])
            inverse -= inverse[:, own] @ gain
        return np.exp(logs), float(np.log1p(_APART**2 * np.maximum(bends, 0.0)).sum()) / 2

    def gain(self, ratios: Array) -> float:
        """Return by how much ratios of each unit raise the log-likelihood, with that of their differences."""
        size = np.sqrt(np.repeat(ratios, len(self.root)))
        lower = np.linalg.cholesky(self.gram * size[:, None] * size + np.eye(len(size)))
        along = np.linalg.solve(lower, self.along * size)
        squares = self.base.squares - float(along @ along)
        grown = self.base.dof * np.log(self.base.squares / squares) / 2 - np.log(np.diag(lower)).sum()
        return float(grown - ((np.log(ratios) - np.log(ratios).mean()) ** 2).sum() / (2 * _APART**2))


@dataclass(frozen=True)
class _Tried:
    """A process with the variances of the largest likelihood."""

    scored: _Scored
    likelihood: RestrictedLikelihood
    log_ratio: float
    ratios: Array
    """Of the variances of each unit and component, (copies,)"""
    cost: float
    """What their freedom takes from the log-likelihood"""

    @cached_property
    def gain(self) -> float:
        """Of the log-likelihood, against readings that are all noisier by one factor."""
        gain = max(self.likelihood.gain(self.log_ratio), self.scored.gain(self.ratios) - self.cost)
        return gain - gain_of_larger_noise(self.scored.base)

    def process(self, tried: int) -> Process:
        """Return the process, of one of so many covariates that were tried."""
        one, basis = self.scored, self.scored.basis
        knots, size = len(one.root), np.sqrt(self.ratios)
        # beside the unknowns alone: what looks like a named effect belongs to the uncertainty of that
        each = np.stack([one.root * own for own in size])
        values, vectors = np.linalg.eigh(_turned(basis.gram, each))
        vectors = vectors[:, values > _VISIBLE].reshape(len(size), knots, -1) * size[:, None, None]
        columns = basis.columns @ np.einsum("ij,ajk->aik", one.root, vectors).reshape(-1, vectors.shape[2])
        seen = self.likelihood
        means = {unit: self.ratios[np.array(basis.units) == unit].mean() for unit in basis.sigmas}
        unit = max(means, key=lambda unit: means[unit])
        std = float(np.sqrt(means[unit] * seen.squares(self.log_ratio) / seen.dof)) * basis.sigmas[unit]
        level = min(log_level_of(self.gain) + float(np.log(tried)), 0.0)
        spread = std * seen.relative_spread(self.log_ratio)
        # the functions of a copy sum to 1 in its rows: that is the stated deviation, which it has at the knots
        whole = basis.columns @ np.repeat(size, knots)
        visible = float(np.sqrt(np.maximum(values, 0.0).sum() / (whole @ whole)))
        return Process(basis.name, basis.by, one.length, std, spread, visible, unit, level, self.gain, columns)
