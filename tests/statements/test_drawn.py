"""The benchmark `statements` calls a wrong statement wrong: numbers of a straight line, and a wrong uncertainty of it."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.apart.model import Model
from benchmarks.apart.statement import Statement, detectable, uncertainties

AT = np.linspace(0.0, 1.0, 11)
LINE = Model(
    lambda x: x[0] + x[1] * AT,
    np.full(11, 0.1),
    np.array([2.0, 3.0]),
    {"slope": lambda x: float(x[1])},
    {(str(i),): i for i in range(11)},
)
SLOPE = 0.1 / float(np.sqrt(((AT - AT.mean()) ** 2).sum()))
REDUNDANCY = 1 - 1 / 11 - 0.25 / float(((AT - AT.mean()) ** 2).sum())
"""Of a reading at an end"""
LEAST = 0.1 * (3.29 + 0.8416) / float(np.sqrt(REDUNDANCY))
"""Baarda: found with 80 % beyond |w| = 3.29"""


@pytest.mark.parametrize(("times", "right"), [(1.0, True), (1.2, False), (0.8, False)])
def test_wrong_statements_do_not_hold(times: float, right: bool) -> None:
    statements: list[Statement] = [
        *uncertainties("line", "", LINE, {"slope": times * SLOPE}, ""),
        *detectable("line", "", LINE, {("0",): times * LEAST}, (3.29, 1.0)),
    ]
    assert [one.check(np.random.default_rng(3)).holds for one in statements] == [right, right]
