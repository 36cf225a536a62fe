"""How an adjustment ends.

Method: docs/algorithms/rank-in-words.md.
"""

from __future__ import annotations

from enum import Enum

from metrocli.frozen import dataclass


class Outcome(Enum):
    """The outcome of an adjustment; its value is the sentence that is reported."""

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
    """A combination of unknowns that the readings leave undetermined, or less certain than is plausible."""

    parts: tuple[tuple[str, str, str, float], ...]
    """What changes together: (block, column, members, share); members '' means all, share is relative to the largest"""
    spread: float
    """Standard uncertainty of the combination in units of the unknowns' plausible reach; inf if it is undetermined"""

    def __str__(self) -> str:
        words = []
        for block, column, members, _ in self.parts:
            # a member's noun may be in the name of its block: "x of tracer LT1", not "x of tracer tracer LT1", and
            # "x of station S2", not "x of levelled station station S2"
            noun = members.removeprefix("all ")
            named = noun.startswith(block) or noun.partition(" ")[0].removesuffix("s") in block.split()
            words.append(f"{column} of {members if named else f'{block} {members}'.strip()}")
        return ", ".join(words)
