"""The state of a selection: effects, smooth terms and outliers fitted together, and the level of each of them.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, FittedParts
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Chosen:
    """A member of the selection: an alternative of a family, or an outlier (family -1, number of the reading)."""

    family: int
    number: int
    columns: Array
    aliases: tuple[tuple[str, float, float], ...] = ()
    """Other values of a scanned parameter that fit alike: its name, the value, and the odds against the chosen one"""

    @property
    def outlier(self) -> bool:
        """Whether the member is an outlier."""
        return self.family < 0


@dataclass(frozen=True)
class Selection:
    """Members that the readings require in addition to the model of the job."""

    test_set: ScoreTests
    fit: FittedParts
    chosen: tuple[Chosen, ...] = ()
    """Members, in the order of the parts of the fit"""

    @property
    def named(self) -> tuple[Chosen, ...]:
        """The effects, without smooth terms and outliers."""
        return tuple(one for one in self.chosen if not one.outlier and not self.test_set.families[one.family].unknown)

    @property
    def unknown(self) -> tuple[Chosen, ...]:
        """The smooth terms."""
        return tuple(one for one in self.chosen if not one.outlier and self.test_set.families[one.family].unknown)

    @property
    def outliers(self) -> tuple[Chosen, ...]:
        """The outliers."""
        return tuple(one for one in self.chosen if one.outlier)

    @property
    def members(self) -> frozenset[tuple[int, int]]:
        """Family and number of all members."""
        return frozenset((one.family, one.number) for one in self.chosen)

    def alternative(self, one: Chosen) -> Alternative:
        """Return which effect a member is, and where."""
        return self.test_set.alternative(one.family, one.number)

    def fitted(self, without: Sequence[Chosen] = ()) -> FittedColumns:
        """Return the fit of all members except those in `without`."""
        gone = [number for number, one in enumerate(self.chosen) if any(one is other for other in without)]
        return self.fit.without(gone) if gone else self.fit.fitted

    def with_one(self, one: Chosen, instead: Chosen | None = None) -> Selection:
        """Return the selection with one more member, or with this member instead of another."""
        kept = self if instead is None else self.without(instead)
        products = self.test_set.remembered.products.get((one.family, one.number), {})
        return replace(kept, fit=kept.fit.with_part(one.columns, products), chosen=(*kept.chosen, one))

    def without(self, *gone: Chosen) -> Selection:
        """Return the selection without some of its members."""
        kept = [number for number, one in enumerate(self.chosen) if not any(one is other for other in gone)]
        return replace(self, fit=self.fit.only(kept), chosen=tuple(self.chosen[number] for number in kept))

    def wrong_at(self, one: Chosen) -> tuple[Chosen, ...]:
        """Return the selected outliers at the place of an effect, such as the readings of an image with a bad pose."""
        alternative = self.alternative(one)
        place = set(zip(alternative.effect.keys, alternative.instance, strict=True))
        return tuple(other for other in self.outliers if place and place <= self.test_set.keys_of(other.number).items())

    def around(self, one: Chosen) -> tuple[Chosen, ...]:
        """Return the selected smooth terms in which an effect lies; beside them the effect would not be visible."""
        return tuple(
            other
            for other in self.unknown
            if one.family >= 0 and self.test_set.lying_in(other.family, other.number)[one.family][one.number]
        )

    def beside(self, one: Chosen) -> FittedColumns:
        """Return the fit without one member and without the smooth terms in which it lies (marginality)."""
        return self.fitted(without=[one, *self.around(one)])


@dataclass(frozen=True)
class Drop:
    """Reduction of the sum of squares by a part of the model, and the degrees of freedom of this part."""

    squares: float
    dof: float


def drop(without: FittedColumns, beside: FittedColumns) -> Drop:
    """Return the reduction from a smaller model `without` a part to a larger model `beside` it."""
    return Drop(without.squares - beside.squares, without.dof - beside.dof)


def levels_of(selection: Selection) -> list[float]:
    """Return ln of the level of each member beside the others, corrected for all tests."""
    found = _outlier_gains(selection)
    return [_level(selection, one, found.get(id(one))) for one in selection.chosen]


def _level(selection: Selection, one: Chosen, own: Drop | None) -> float:
    test_set, around = selection.test_set, selection.around(one)
    full = selection.fitted(without=around)
    own = drop(selection.beside(one), full) if own is None else own
    if own.dof < 1:
        return 0.0
    share = np.array(own.squares / max(full.squares + own.squares, 1e-300))
    level = test_set.overall(test_set.level(one.family, float(log_tail(share, own.dof, max(full.dof, 1)))))
    if not around:
        return level
    smooth = [(other.family, other.number) for other in around]
    return max(level, special(test_set, one.family, smooth, own, drop(full, selection.fitted())))


def special(test_set: ScoreTests, family: int, smooth: Sequence[tuple[int, int]], own: Drop, rest: Drop) -> float:
    """Return ln of the level at which an effect stands out of smooth terms in which it lies.

    `smooth` are family and number of the terms. `own` is the reduction by the effect, `rest` the further reduction by
    the terms. Under the null hypothesis all directions of the terms are equally likely. The level is corrected for the
    number of effects that lie in the terms.
    """
    if rest.dof < 1:
        return 0.0
    share = np.array(np.clip(own.squares / max(own.squares + rest.squares, 1e-300), 0.0, 1.0))
    return test_set.level(family, float(log_tail(share, own.dof, rest.dof))) + float(np.log(test_set.causes_in(smooth)))


def _outlier_gains(selection: Selection) -> dict[int, Drop]:
    """Return the reduction by each outlier beside all other members, and its rank, from one solution."""
    outliers = selection.outliers
    if not outliers:
        return {}
    base = selection.fitted(without=outliers)
    x = np.concatenate([one.columns for one in outliers], axis=1)
    x = base.beside(x)
    size = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    inverse = np.linalg.pinv((x / size).T @ (x / size), rcond=1e-11, hermitian=True)
    beta = inverse @ ((x / size).T @ base.residual)
    found, place = {}, 0
    for one in outliers:
        own = slice(place, place + one.columns.shape[1])
        place = own.stop
        values, vectors = np.linalg.eigh(inverse[own, own])
        good = values > 1e-9 * max(float(values[-1]), 1e-300)
        gain = float((((vectors.T @ beta[own]) ** 2)[good] / values[good]).sum())
        found[id(one)] = Drop(gain, float(good.sum()))
    return found
