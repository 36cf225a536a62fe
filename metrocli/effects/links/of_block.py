"""Bases of all links of effects."""

from __future__ import annotations

from metrocli.adjust.model.quantities import Quantity
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class OfBlock:
    """A link whose parameters are the columns of one block of its own."""

    block: str

    @property
    def blocks(self) -> tuple[str, ...]:
        """The name of its own block."""
        return (self.block,)


@dataclass(frozen=True)
class AtQuantity(OfBlock):
    """A link that changes the quantity `at`, so that one effect serves several frames or instruments."""

    at: Quantity

    @property
    def takes(self) -> Quantity:
        """The quantity on which it acts."""
        return self.at

    @property
    def gives(self) -> Quantity:
        """The same quantity."""
        return self.at
