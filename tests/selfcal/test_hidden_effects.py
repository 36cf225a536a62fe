"""A few cases of the hidden-effect campaign on views of a ball grid; the whole of it: python -m benchmarks grid_hidden."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.hidden import grids, rates
from benchmarks.hidden.case import Found

NOTHING, LARGE, OUTSIDE, TWO = (0, 2, 11), (3, 7, 12, 15), (18,), (17,)
"""Numbers of cases without an effect, with one of twice its least detectable size or more, with one of no table, two"""


@cache
def found(number: int) -> Found:
    return rates.found(grids.case(number))


@pytest.mark.parametrize("number", NOTHING)
def test_where_nothing_is_hidden_nothing_is_named(number: int) -> None:
    one = found(number)
    assert not one.case.hidden
    assert one.diagnosis.verdict == "clean"
    told = {tuple(outlier.keys.values()) for outlier in one.diagnosis.outliers}
    assert told == set(one.case.outliers)


@pytest.mark.parametrize("number", LARGE)
def test_what_is_hidden_is_named_with_its_place(number: int) -> None:
    one = found(number)
    assert len(one.case.hidden) == 1
    assert one.diagnosis.verdict in ("explained", "indistinct")
    assert rates._each_in_sets(one)
    assert one.covered


@pytest.mark.parametrize("number", TWO)
def test_two_effects_are_both_named(number: int) -> None:
    one = found(number)
    assert len(one.case.hidden) == 2
    assert rates._each_in_sets(one)


@pytest.mark.parametrize("number", OUTSIDE)
def test_an_effect_of_no_table_is_called_unknown(number: int) -> None:
    one = found(number)
    assert one.case.hidden[0].name[0] == "_"
    assert one.diagnosis.verdict == "unexplained"


def test_the_noise_is_found() -> None:
    inside = [found(n).diagnosis.noise.low <= found(n).case.noise <= found(n).diagnosis.noise.high for n in (0, 2, 12)]
    assert all(inside)


def test_the_cases_share_nothing_with_the_solver() -> None:
    """What the machine, the artefact and the mountings can follow: the same space, found from formulas written twice."""
    from metrocli.adjust.coupled import design_of
    from metrocli.tasks.grid_problem import build
    from metrocli.tasks.grid_readings import Readings
    from metrocli.tasks.grid_settings import views_of

    for names in ("1234", "123456"):
        m = grids.measurement(np.random.default_rng(1), names)
        settings, v = grids.job(names, grids.NOISE), grids.views(names)
        table = m.subject().model.readings[0]
        assert table.observations.count == len(v.view)
        from metrocli.table import Table

        columns = {"view": np.array(list(names))[v.view], **dict(zip("ijk", v.balls[v.ball].T, strict=True))}
        readings = Readings(tuple(views_of(settings)), v.view, v.balls[v.ball], m.readings, Table(columns))
        design = design_of(build(readings, (settings.grid.half, grids.PITCH), grids.NOISE).fields)
        n = len(v.view)
        rows = np.concatenate([np.arange(3) * n + i for i in range(n)])
        jacobian = design.jacobian.toarray()[rows]
        basis = grids.absorbed(names)
        assert basis.shape[1] == jacobian.shape[1] - 13
        left = jacobian - basis @ (basis.T @ jacobian)
        assert np.abs(left).max() < 1e-9 * np.abs(jacobian).max()
