"""Base of all links of effects."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OfBlock:
    """A link whose parameters are the columns of one block of its own."""

    block: str

    @property
    def blocks(self) -> tuple[str, ...]:
        """The name of its own block."""
        return (self.block,)
