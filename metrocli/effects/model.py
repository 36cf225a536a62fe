"""A model that effects can be added to: blocks, groups and datum, and the places where effects can act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.rounds import Aspect
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.effect import Effect
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Place:
    """One kind of place where effects can act, such as the tracers, the images or the axes."""

    names: tuple[str, ...]
    index: str = ""
    """Index of the observations that gives the place of each reading; empty if every reading concerns all places"""


@dataclass(frozen=True)
class Added:
    """An effect that is in a model."""

    effect: Effect
    instances: tuple[tuple[str, ...], ...]
    """Names of the places where it acts, in the order of `effect.where`; one empty tuple if it acts everywhere"""
    block: str
    columns: tuple[str, ...]
    """Names of its estimated parameters"""
    std: float = 0.0
    """Standard deviation of its sizes at all places of its kind; 0 if nothing is known of its sizes"""

    @property
    def label(self) -> str:
        """Name of the effect and its place, with which the names of its estimates begin."""
        return ".".join([self.effect.name, *(self.instances[0] if len(self.instances) == 1 else ())])


@dataclass(frozen=True)
class Model:
    """Blocks, groups and datum of an adjustment, with the places where effects can act."""

    blocks: Mapping[str, Block]
    groups: tuple[Group, ...]
    datum: Datum | None = None
    measured: tuple[str, ...] = ()
    """Names of the groups of readings; effects act on these, while the other groups are priors and conditions"""
    places: Mapping[str, Place] = field(default_factory=dict)
    aspects: Mapping[str, Aspect] = field(default_factory=dict)
    """Conditions that follow from the geometry, by name; they are evaluated at the present values of the blocks"""
    added: tuple[Added, ...] = ()
    nominal: Mapping[str, Array] = field(default_factory=dict)
    """For the block whose members are the points of the readings: their nominal coordinates, (members, 3)"""

    @property
    def readings(self) -> tuple[Group, ...]:
        """The groups of readings."""
        return tuple(group for group in self.groups if group.name in self.measured)

    @property
    def others(self) -> tuple[Group, ...]:
        """The other groups: priors and conditions."""
        return tuple(group for group in self.groups if group.name not in self.measured)

    def group(self, name: str) -> Group:
        """Return the group of this name."""
        return next(group for group in self.groups if group.name == name)

    def units_in(self, group: Group, by: str) -> Index:
        """Return the number of the place of a kind for each reading, (n,); 0 for all of a group without such places."""
        index = group.observations.index.get(self.places[by].index) if by else None
        return np.zeros(group.observations.count, dtype=np.intp) if index is None else index

    def with_group(self, group: Group) -> Model:
        """Return the model with this group in place of the group of the same name."""
        return replace(self, groups=tuple(group if other.name == group.name else other for other in self.groups))

    def kept(self, keep: Mapping[str, Mask]) -> Model:
        """Return the model with some of the readings of the groups that are named, (n,) each."""
        groups = (group.selected(keep[group.name]) if group.name in keep else group for group in self.groups)
        return replace(self, groups=tuple(groups))

    def with_blocks(self, blocks: Mapping[str, Block]) -> Model:
        """Return the model with other values of its blocks."""
        return replace(self, blocks=dict(blocks))

    def about_no_scatter(self) -> Model:
        """Return the model with the sizes of random effects at 0, their mean.

        Derivatives about estimated sizes contain these. An effect whose derivative the unknowns nearly absorb would
        then have what is left of them as its signature, and take their prior with it.
        """
        random = {added.block for added in self.added if added.std}
        zero = {name: self.blocks[name].with_values(np.zeros(self.blocks[name].values.shape)) for name in random}
        return self.with_blocks({**self.blocks, **zero}) if random else self
