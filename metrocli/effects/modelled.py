"""Base of what each kind of job adjusts: a model that can be extended by effects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Self

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.effects.correlated import with_all
from metrocli.effects.model import Added, Model
from metrocli.effects.requested import RequestedEffect
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Modelled:
    """A model that a kind of job adjusts; a subclass adds what else that kind needs."""

    model: Model

    @property
    def blocks(self) -> Mapping[str, Block]:
        """The blocks of unknowns."""
        return self.model.blocks

    @property
    def others(self) -> tuple[Group, ...]:
        """Priors and conditions."""
        return self.model.others

    @property
    def datum(self) -> Datum | None:
        """The datum that fixes the frame of a free network; None if the data fix it."""
        return self.model.datum

    @property
    def effects(self) -> tuple[Added, ...]:
        """The effects in the model."""
        return self.model.added

    def with_model(self, model: Model) -> Self:
        """Return a copy with another model."""
        return replace(self, model=model)

    def with_blocks(self, blocks: Mapping[str, Block]) -> Self:
        """Return a copy with other values of the blocks."""
        return self.with_model(self.model.with_blocks(blocks))

    def with_effects(self, requests: Iterable[RequestedEffect]) -> Self:
        """Return a copy whose model has the effects that a job names; raises InputError as `with_all` does."""
        return self.with_model(with_all(self.model, requests))
