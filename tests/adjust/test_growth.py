"""Time and memory grow with the number of views, not with its square."""

from __future__ import annotations

import time
import tracemalloc

from adjust.problems import board_camera

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.outcome import Outcome

FEW, MANY = 150, 600


def seconds_of(views: int) -> float:
    """CPU seconds of one adjustment with covariance."""
    problem = board_camera(views=views)
    before = time.process_time()
    solution = adjust(problem.blocks.values(), problem.groups)
    solution.std("view")
    assert solution.outcome is Outcome.CONVERGED
    return time.process_time() - before


def peak_of(views: int) -> int:
    """Peak of memory of one adjustment with covariance, in bytes."""
    problem = board_camera(views=views)
    tracemalloc.start()
    adjust(problem.blocks.values(), problem.groups).std("view")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_time_is_linear_in_views() -> None:
    # A square law would give 16; the two sizes take turns, so that a busy machine slows both alike.
    few, many = zip(*[(seconds_of(FEW), seconds_of(MANY)) for _ in range(5)], strict=True)
    assert min(many) < 9 * min(few)


def test_memory_is_linear_in_views() -> None:
    # Below 4, since the working memory of a tile does not grow at all; a square law would give 16.
    assert 1 < peak_of(MANY) / peak_of(FEW) < 5
