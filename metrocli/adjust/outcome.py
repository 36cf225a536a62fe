"""How an adjustment can end."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Outcome(Enum):
    """Each outcome as the sentence that is told."""

    CONVERGED = "the adjustment converged"
    UNDETERMINED = "the data cannot determine the unknowns"
    TOO_FEW = "there are fewer readings than unknowns"
    ITERATION_LIMIT = "the adjustment did not converge within its limit of iterations"
    NO_START = "the readings cannot be predicted at the starting values"
    DIVERGED = "the adjustment found no step that lowers the sum of squares"

    @property
    def good(self) -> bool:
        """Whether the values are a solution with a covariance."""
        return self is Outcome.CONVERGED


@dataclass(frozen=True)
class Combination:
    """A direction of the unknowns that the readings leave open, or that is uncertain beyond all plausible values."""

    parts: tuple[tuple[str, str, str, float], ...]
    """What moves together: (block, column, members, share); members is '' for all, share is relative to the largest"""
    spread: float
    """Standard uncertainty along it in units of the unknowns' plausible reach; inf where it is open"""

    def __str__(self) -> str:
        words = []
        for block, column, members, _ in self.parts:
            # a member's noun may be the name of its block: "x of tracer LT1", not "x of tracer tracer LT1"
            named = members.removeprefix("all ").startswith(block)
            words.append(f"{column} of {members if named else f'{block} {members}'.strip()}")
        return ", ".join(words)
