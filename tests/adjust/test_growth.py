"""Time and memory grow with the number of views, not with its square."""

from __future__ import annotations

import time
import tracemalloc

from adjust.problems import board_camera

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.outcome import Outcome

FEW, MANY = 100, 400


def cost(views: int) -> tuple[float, int]:
    """CPU seconds of one adjustment with covariance (the better of three) and its peak of memory."""
    problem = board_camera(views=views)
    seconds = []
    for _ in range(3):
        before = time.process_time()
        solution = adjust(problem.blocks.values(), problem.groups)
        solution.std("view")
        seconds.append(time.process_time() - before)
        assert solution.outcome is Outcome.CONVERGED
    tracemalloc.start()
    adjust(problem.blocks.values(), problem.groups).std("view")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return min(seconds), peak


def test_cost_is_linear_in_views() -> None:
    few, many = cost(FEW), cost(MANY)
    assert many[0] < 7 * few[0]
    assert 3 < many[1] / few[1] < 5
