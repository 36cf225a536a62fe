"""Observations: readings, their covariance, the members that each uses, and the conditions of the measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any

import numpy as np

from metrocli.arrays import Array as Array
from metrocli.arrays import Index as Index
from metrocli.arrays import Mask as Mask
from metrocli.frozen import dataclass

TIME = "time"
"""Key by which readings differ that are alike in all other keys"""


@dataclass(frozen=True)
class Lattice:
    """Readings in regular order: the first readings of k members of a block, then their second ones, up to the m-th.

    Reading `j k + i` is the j-th of `members[i]`; of every other block it uses the member `slots[block][j]`.
    """

    block: str
    members: Index | slice
    """(k,)"""
    slots: Mapping[str, Index]
    """(m,) for each other block: its member that the j-th readings use"""
    shape: tuple[int, int]
    """(m, k)"""

    def index(self, block: str) -> Index:
        """Return which member of a block each reading uses, (m k,)."""
        if block == self.block:
            members = self.members
            here = np.arange(members.start, members.stop) if isinstance(members, slice) else members
            return np.tile(here, self.shape[0])
        return np.repeat(self.slots[block], self.shape[1])

    def spread(self, per_member: Array, block: str) -> Array:
        """Return values of the members (members, ...) at the readings, (..., m k)."""
        along_members = block == self.block
        chosen = np.moveaxis(per_member[self.members if along_members else self.slots[block]], 0, -1)
        full = np.empty((*chosen.shape[:-1], *self.shape))
        full[...] = chosen[..., None, :] if along_members else chosen[..., None]
        return full.reshape(*chosen.shape[:-1], self.shape[0] * self.shape[1])


_MOST_BY_ROWS = 3
"""Components of a reading, at most, that are decorrelated row by row"""


@dataclass(frozen=True)
class Observations:
    """n readings of d components each.

    The observation axis is always the last one, so that arithmetic runs along it.
    """

    readings: Array
    """(d, n)"""
    sigma: Array
    """Standard deviations, broadcast to (d, n); not used if `covariance` is set"""
    index: Mapping[str, Index] = field(default_factory=dict)
    """For each block the member that each reading uses, (n,), or (k, n) if a reading uses k members"""
    covariance: Array | None = None
    """(d, d, n) if the components of a reading are correlated"""
    keys: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names that identify each reading: image, target, ..."""
    conditions: Mapping[str, Array] = field(default_factory=dict)
    """Time, temperature, ... of each reading, (n,)"""
    components: tuple[str, ...] = ("",)
    """Name of each of the d components, e.g. u, v"""
    unit: str = ""
    units: tuple[str, ...] = ()
    """Unit of each component where they differ: displacements and angles"""
    ratios: Array | None = None
    """Factors (n,) on the standard deviations of the readings, those of their variance groups; None means 1"""
    lattice: Lattice | None = None
    """The regular order of the readings of a tile; it stands for the `index` of blocks that are not in `index`"""
    _whitening: Array | None = field(default=None, init=False, repr=False)
    """Inverse Cholesky factor of the covariance of each reading, (d, d, n)"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", np.broadcast_to(np.asarray(self.sigma, dtype=float), self.readings.shape))
        whitening = None
        if self.covariance is not None:
            # once here and not at each step: the covariance of readings stays as it is through an adjustment
            inverse = np.linalg.inv(np.linalg.cholesky(np.moveaxis(self.covariance, -1, 0)))
            whitening = np.ascontiguousarray(np.moveaxis(inverse, 0, -1))
            whitening = whitening if self.ratios is None else whitening / self.ratios
        object.__setattr__(self, "_whitening", whitening)

    @property
    def count(self) -> int:
        """Number of readings n."""
        return int(self.readings.shape[1])

    @property
    def unit_of_each(self) -> tuple[str, ...]:
        """Unit of each component."""
        return self.units or (self.unit,) * len(self.readings)

    @property
    def order(self) -> Array:
        """What puts the readings in order, (n,): their times, or without these their numbers."""
        return self.conditions.get("t", np.arange(self.count, dtype=float))

    @property
    def deviations(self) -> Array:
        """Standard deviation of each component, (d, n)."""
        if self.covariance is None:
            return self.stds
        return np.asarray(np.sqrt(np.einsum("aan->an", self._covariances)))

    @property
    def stds(self) -> Array:
        """Standard deviation of each component if the components are not correlated, (d, n)."""
        return self.sigma if self.ratios is None else self.sigma * self.ratios

    def deviations_in(self, unit: str) -> Array:
        """Return the standard deviations of the components in a unit, (numbers,); none if it has no such."""
        return self.deviations[[own == unit for own in self.unit_of_each]].ravel()

    @property
    def _covariances(self) -> Array:
        """Covariance of the components of each reading, (d, d, n), also where they are not correlated."""
        if self.covariance is not None:
            return self.covariance if self.ratios is None else self.covariance * self.ratios**2
        return np.asarray(self.stds**2 * np.eye(len(self.sigma))[:, :, None])

    def whitened(self, values: Array) -> Array:
        """Return values (d, ..., n) decorrelated and in units of their standard deviations."""
        if self._whitening is not None:
            if len(values) > _MOST_BY_ROWS:
                return np.asarray(np.einsum("abn,b...n->a...n", self._whitening, values))
            # lower triangular; whole rows are several times faster than einsum
            rows = [
                sum(self._whitening[row, column] * values[column] for column in range(row + 1))
                for row in range(len(values))
            ]
            return np.stack(rows)
        between = (1,) * (values.ndim - 2)
        sigma = self.stds
        scaled: Array = values / sigma.reshape(sigma.shape[0], *between, sigma.shape[1])
        return scaled

    def selected(self, keep: Mask | Index) -> Observations:
        """Return the readings chosen by a mask or by indices (n,)."""
        # large tables are not copied where nothing is left out
        if keep.dtype == bool and keep.all():
            return self
        chosen: Index = np.flatnonzero(keep) if keep.dtype == bool else np.asarray(keep, dtype=np.intp)
        rows = chosen.tolist()  # a tuple takes them several times faster than elements of an array
        return replace(
            self,
            **self._values_of(chosen),
            index={name: index[..., chosen] for name, index in self.index.items()},
            keys={name: tuple(map(values.__getitem__, rows)) for name, values in self.keys.items()},
        )

    def in_lattice(self, chosen: Index, lattice: Lattice) -> Observations:
        """Return the readings chosen by indices (n,) that are in the regular order of `lattice`; without keys."""
        return replace(self, **self._values_of(chosen), index={}, keys={}, lattice=lattice)

    def without_keys(self, chosen: Index | slice) -> Observations:
        """Return the readings chosen by indices (n,) or a slice, without their keys."""
        index = {name: index[..., chosen] for name, index in self.index.items()}
        return replace(self, **self._values_of(chosen), index=index, keys={})

    def _values_of(self, chosen: Index | slice) -> dict[str, Any]:
        """Return the fields with one number for each reading, of the chosen readings."""
        return {
            "readings": self.readings[:, chosen],
            "sigma": self.sigma[:, chosen],
            "covariance": None if self.covariance is None else self.covariance[:, :, chosen],
            "ratios": None if self.ratios is None else self.ratios[chosen],
            "conditions": {name: values[chosen] for name, values in self.conditions.items()},
        }

    def with_readings(self, readings: Array) -> Observations:
        """Return the same observations with other readings."""
        return replace(self, readings=readings)

    def with_index(self, index: Mapping[str, Index]) -> Observations:
        """Return the readings with other or further members of blocks that they use."""
        return replace(self, index={**self.index, **index})

    def with_conditions(self, conditions: Mapping[str, Array]) -> Observations:
        """Return the readings with other or further conditions."""
        return replace(self, conditions={**self.conditions, **conditions})

    def followed_by(self, others: Observations) -> Observations:
        """Return these readings followed by others of the same kind."""
        correlated = self.covariance is not None or others.covariance is not None
        return replace(
            self,
            covariance=np.concatenate([self._covariances, others._covariances], axis=2) if correlated else None,
            ratios=None,
            readings=np.concatenate([self.readings, others.readings], axis=1),
            sigma=np.concatenate([self.stds, others.stds], axis=1),
            index={name: np.concatenate([index, others.index[name]], axis=-1) for name, index in self.index.items()},
            keys={name: (*values, *others.keys[name]) for name, values in self.keys.items()},
            conditions={
                name: np.concatenate([values, others.conditions[name]]) for name, values in self.conditions.items()
            },
        )
