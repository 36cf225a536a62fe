"""A model that effects can be added to: blocks, groups and datum, and the places where effects can act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from metrocli.adjust.datum import Datum
from metrocli.adjust.iterated_weights import Aspect
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.effects.effect import Effect


@dataclass(frozen=True)
class Place:
    """Names of one kind of place where effects can act: the tracers, the images, the axes."""

    names: tuple[str, ...]
    index: str = ""
    """The index of the observations that says which of them a reading concerns; "": each reading concerns all"""


@dataclass(frozen=True)
class Added:
    """An effect that is in a model."""

    effect: Effect
    instances: tuple[tuple[str, ...], ...]
    """Names of places where it acts, in the order of `effect.where`; one empty tuple where it acts everywhere"""
    block: str
    columns: tuple[str, ...]
    """Its parameters that are estimated"""

    @property
    def label(self) -> str:
        """The name of the effect with its place, as estimates are named."""
        return ".".join([self.effect.name, *(self.instances[0] if len(self.instances) == 1 else ())])


@dataclass(frozen=True)
class Model:
    """What is adjusted, with the places where effects can act."""

    blocks: Mapping[str, Block]
    groups: tuple[Group, ...]
    datum: Datum | None = None
    measured: tuple[str, ...] = ()
    """Names of the groups of readings, on which effects act; the others are priors and conditions"""
    places: Mapping[str, Place] = field(default_factory=dict)
    aspects: Mapping[str, Aspect] = field(default_factory=dict)
    """Conditions that follow from where things are, by name; they are taken at the present values"""
    added: tuple[Added, ...] = ()

    @property
    def readings(self) -> tuple[Group, ...]:
        """The groups of readings."""
        return tuple(group for group in self.groups if group.name in self.measured)

    @property
    def others(self) -> tuple[Group, ...]:
        """The groups that are no readings: priors and conditions."""
        return tuple(group for group in self.groups if group.name not in self.measured)

    def group(self, name: str) -> Group:
        """Return the group of this name."""
        return next(group for group in self.groups if group.name == name)

    def with_group(self, group: Group) -> Model:
        """Return the model with a group in the place of the one of its name."""
        return replace(self, groups=tuple(group if one.name == group.name else one for one in self.groups))

    def with_blocks(self, blocks: Mapping[str, Block]) -> Model:
        """Return the model at other values."""
        return replace(self, blocks=dict(blocks))
