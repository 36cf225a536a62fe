"""Joint description of the input quantities: best estimates, covariance, degrees of freedom, and random draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field

import numpy as np

from metrocli.arrays import Array, Mask
from metrocli.expressions.dimensions import Compound
from metrocli.frozen import dataclass
from metrocli.uncertainty.correlated import CLIP, Dependent, DrawnRows, JointDistribution, UnreachableError, factor
from metrocli.uncertainty.distributions import Distribution, Normal, Sampled, in_trials


@dataclass(frozen=True)
class InputQuantity:
    """One input: best estimate and distribution in base units, and the unit in which it is shown."""

    name: str
    value: float
    distribution: Distribution | None
    """None for a constant"""
    dof: float = math.inf
    unit: Compound = field(default_factory=lambda: Compound("1", 1.0, ()))

    @property
    def std(self) -> float:
        """Standard uncertainty."""
        return 0.0 if self.distribution is None else self.distribution.std


@dataclass(frozen=True)
class CorrelatedBlock:
    """Quantities from one result, with their covariance."""

    names: tuple[str, ...]
    covariance: Array


class NotSemiDefiniteError(ValueError):
    """Error for a correlation matrix that is not positive semi-definite, with the names that contradict each other."""

    def __init__(self, names: Sequence[str], eigenvalue: float) -> None:
        super().__init__(f"no quantities have these correlations: smallest eigenvalue {eigenvalue:.3g}")
        self.names = tuple(names)
        self.eigenvalue = eigenvalue


@dataclass(frozen=True)
class Inputs:
    """n quantities with their joint covariance."""

    quantities: tuple[InputQuantity, ...]
    covariance: Array
    """(n, n)"""
    groups: tuple[tuple[int, ...], ...]
    """Groups of quantities that are correlated with each other or come from one result; each is in one group"""
    together: tuple[tuple[int, ...], ...] = ()
    """Groups of samples that are drawn row by row"""

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the covariance."""
        return tuple(quantity.name for quantity in self.quantities)

    @property
    def values(self) -> dict[str, float]:
        """Best estimates by name."""
        return {quantity.name: quantity.value for quantity in self.quantities}

    def sources(self) -> tuple[Callable[[np.random.Generator, int], Sequence[tuple[int, Array]]], ...]:
        """Return functions that draw deviations, one for each group, in the order of the quantities."""
        return tuple(
            self._source(group) for group in self.groups if self.covariance[group[0], group[0]] > 0 or len(group) > 1
        )

    def _source(self, group: tuple[int, ...]) -> Dependent | JointDistribution | DrawnRows | _Single:
        shapes = [in_trials(self._shape(i), self.quantities[i].dof) for i in group]
        if len(group) == 1:
            return _Single(group[0], shapes[0])
        if group in self.together:
            return DrawnRows(group, tuple(shape for shape in shapes if isinstance(shape, Sampled)))
        part = self.covariance[np.ix_(group, group)]
        std = np.sqrt(np.diag(part))
        moving = [k for k in range(len(group)) if std[k] > 0]
        root, dofs = factor(part), {self.quantities[i].dof for i in group}
        # the least of different dof: no formula holds there, and the least is the safe side
        ellipse = JointDistribution(group, root, min(dofs))
        normal = all(isinstance(self._shape(i), Normal) for i in group)
        # t distributions of different dof would break the exact relations of a singular covariance
        if normal and (len(dofs) == 1 or root.shape[1] < len(moving)):
            return ellipse
        correlation = part[np.ix_(moving, moving)] / std[moving][:, None] / std[moving]
        try:
            return Dependent.of(tuple(group[k] for k in moving), [shapes[k] for k in moving], correlation)
        except UnreachableError:
            if normal:
                return ellipse
            raise

    def _shape(self, index: int) -> Distribution:
        return self.quantities[index].distribution or Normal(0.0)


@dataclass(frozen=True)
class _Single:
    """A quantity that is correlated with no other."""

    index: int
    distribution: Distribution

    def __call__(self, rng: np.random.Generator, count: int) -> Sequence[tuple[int, Array]]:
        return [(self.index, self.distribution.draw(rng, count))]


def join(
    quantities: Sequence[InputQuantity],
    correlations: Iterable[tuple[str, str, float]] = (),
    blocks: Sequence[CorrelatedBlock] = (),
    rows: Iterable[Sequence[str]] = (),
) -> Inputs:
    """Return the quantities with their joint covariance; raises NotSemiDefiniteError.

    Covariances of blocks are used unchanged, also rank-deficient ones; correlations are added to them. `rows` are the
    samples that are drawn together, row by row.
    """
    place = {quantity.name: i for i, quantity in enumerate(quantities)}
    std = np.array([quantity.std for quantity in quantities])
    covariance = np.diag(std**2)
    for block in blocks:
        held = [place[name] for name in block.names]
        covariance[np.ix_(held, held)] = block.covariance
    for a, b, value in correlations:
        covariance[place[a], place[b]] = covariance[place[b], place[a]] = value * std[place[a]] * std[place[b]]
    _must_be_semi_definite(covariance, tuple(place))
    linked = covariance != 0
    for block in blocks:
        # even uncorrelated estimates of one adjustment share its estimated noise
        held = [place[name] for name in block.names]
        linked[np.ix_(held, held)] = True
    together = [tuple(sorted(place[name] for name in names)) for names in rows]
    for samples in together:
        linked[np.ix_(samples, samples)] = True
    return Inputs(tuple(quantities), covariance, _groups(linked), tuple(together))


def _must_be_semi_definite(covariance: Array, names: Sequence[str]) -> None:
    std = np.sqrt(np.diag(covariance))
    moving = np.flatnonzero(std > 0)
    if not len(moving):
        return
    correlation = covariance[np.ix_(moving, moving)] / std[moving][:, None] / std[moving]
    values, vectors = np.linalg.eigh(correlation)
    # a thousand times the bound of `factor`: stated correlations have few digits, and rounded ones do not contradict
    if values[0] < -1e3 * CLIP * max(values[-1], 1.0):
        weight = np.abs(vectors[:, 0])
        involved = moving[np.flatnonzero(weight > 0.1 * weight.max())]
        raise NotSemiDefiniteError([names[i] for i in involved], float(values[0]))


def _groups(linked: Mask) -> tuple[tuple[int, ...], ...]:
    """Return the connected parts of a graph."""
    left = list(range(len(linked)))
    groups = []
    while left:
        group, frontier = {left[0]}, [left[0]]
        while frontier:
            new = set(np.flatnonzero(linked[frontier.pop()]).tolist()) - group
            group |= new
            frontier += sorted(new)
        groups.append(tuple(sorted(group)))
        left = [i for i in left if i not in group]
    return tuple(groups)
