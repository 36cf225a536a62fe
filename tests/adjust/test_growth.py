"""Memory grows with the number of views, not with its square; time, by `python -m benchmarks limits`, too."""

from __future__ import annotations

import tracemalloc

from adjust.problems import board_camera

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.outcome import Outcome

FEW, MANY = 150, 600


def peak_of(views: int) -> int:
    """Peak of memory of one adjustment with covariance, in bytes."""
    problem = board_camera(views=views)
    tracemalloc.start()
    solution = adjust(problem.blocks.values(), problem.groups)
    solution.std("view")
    assert solution.outcome is Outcome.CONVERGED
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_is_linear_in_views() -> None:
    # Below 4, since the working memory of a tile does not grow at all; a square law would give 16.
    assert 1 < peak_of(MANY) / peak_of(FEW) < 5
