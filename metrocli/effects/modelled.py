"""What a kind of job adjusts: a model, and what else the kind knows of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Self

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.effects.extension import extended
from metrocli.effects.model import Added, Model
from metrocli.effects.wanted import Wanted


@dataclass(frozen=True)
class Modelled:
    """What a kind of job adjusts: a model, and in a class made from this one what else the kind knows of it."""

    model: Model

    @property
    def blocks(self) -> Mapping[str, Block]:
        """The unknowns."""
        return self.model.blocks

    @property
    def others(self) -> tuple[Group, ...]:
        """Priors and conditions."""
        return self.model.others

    @property
    def datum(self) -> Datum | None:
        """What fixes the frame."""
        return self.model.datum

    @property
    def effects(self) -> tuple[Added, ...]:
        """The effects in the model."""
        return self.model.added

    def with_model(self, model: Model) -> Self:
        """Return the same with a model made from its own."""
        return replace(self, model=model)

    def with_blocks(self, blocks: Mapping[str, Block]) -> Self:
        """Return the same at other values."""
        return self.with_model(self.model.with_blocks(blocks))

    def with_effects(self, wanted: Iterable[Wanted]) -> Self:
        """Return the same with the effects that a job names; raises as `extended` does."""
        return self.with_model(extended(self.model, wanted))
