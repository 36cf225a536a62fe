"""Adjustments in rounds: what one of them shows of its readings or their noise is what the next one starts from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.robust import Suspects
from metrocli.adjust.solution import Residuals
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass

P = TypeVar("P")
S = TypeVar("S")
MOST = 30
"""Rounds after which an iteration that has not ended is left as it is"""
_CONTROLLED = 1e-6
"""Redundancy of all readings below which they show nothing of their noise"""


def in_rounds(
    begun: P, solve: Callable[[P], S], renewed: Callable[[P, S], tuple[P, bool]], most: int = MOST
) -> tuple[P, S]:
    """Return the last state of an iteration and its solution.

    `renewed` returns the next state, and whether it has to be solved: readings without the outliers that were found,
    a noise that agrees with the residuals, a new place of linearisation.
    """
    state, solved = begun, solve(begun)
    for _ in range(most):
        state, again = renewed(state, solved)
        if not again:
            break
        solved = solve(state)
    return state, solved


@dataclass(frozen=True)
class Used:
    """Which of n readings an adjustment uses."""

    tests: Array
    """|w| of each reading that was left out, 0 for those in use, (n,)"""

    @property
    def kept(self) -> Mask:
        """The readings in use, (n,)."""
        return np.asarray(self.tests == 0)

    @property
    def rejected(self) -> Index:
        """The rows of the readings that were left out."""
        return np.flatnonzero(self.tests)

    def without(self, found: Suspects, chosen: Index) -> Used:
        """Leave out some of the suspects (places among them), which are numbered by the readings in use."""
        tests = self.tests.copy()
        tests[np.flatnonzero(self.kept)[found.rows[chosen]]] = found.tests[chosen]
        return replace(self, tests=tests)


def worst_of(found: Suspects) -> Index:
    """Return the suspects (places among them) with a test of at least half the largest one.

    A gross error also raises the tests of good readings, but less: these are tested again without it.
    """
    return np.flatnonzero(found.tests >= found.tests.max(initial=0.0) / 2)


def variance_component(found: Sequence[Residuals]) -> float:
    """Return how many times the declared noise readings have, `sqrt(v'Pv / sum r)` with their redundancy numbers r.

    Raises UndeterminedError if there are no more readings than unknowns.
    """
    redundancy = np.concatenate([one.redundancy.ravel() for one in found])
    w = np.concatenate([one.normalised.ravel() for one in found])
    if not redundancy.sum() > _CONTROLLED:
        raise UndeterminedError(
            "noise: the residuals do not show its size: there are no more readings than unknowns; "
            "measure more, or leave out `model`, so that the noise is as declared"
        )
    size = float(np.sqrt((redundancy * w**2).sum() / redundancy.sum()))
    return size if size > 0 else 1.0
