"""The plain formulas of the hidden-effect campaign on views of a ball grid, against the program's."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import grids


@pytest.mark.alike
@pytest.mark.parametrize("names", ["1234", "123456"])
def test_the_cases_share_nothing_with_the_solver(names: str) -> None:
    """What the machine, the artefact and the mountings can follow: the same space, found from formulas written twice."""
    from metrocli.adjust.coupled_fields import design_of
    from metrocli.tasks.selfcal_grid.problem import build
    from metrocli.tasks.selfcal_grid.readings import GridReadings
    from metrocli.tasks.selfcal_grid.settings import views_of

    m = grids.measurement(np.random.default_rng(1), names)
    settings, v = grids.job(names, grids.NOISE), grids.views(names)
    table = m.adjusted().model.readings[0]
    assert table.observations.count == len(v.view)
    from metrocli.table import Table

    columns = {"view": np.array(list(names))[v.view], **dict(zip("ijk", v.balls[v.ball].T, strict=True))}
    readings = GridReadings(tuple(views_of(settings)), v.view, v.balls[v.ball], m.readings, Table(columns))
    design = design_of(build(readings, (settings.grid.half, grids.PITCH), grids.NOISE).fields)
    n = len(v.view)
    rows = np.concatenate([np.arange(3) * n + i for i in range(n)])
    jacobian = design.jacobian.toarray()[rows]
    basis = grids.absorbed(names)
    assert basis.shape[1] == jacobian.shape[1] - 13
    left = jacobian - basis @ (basis.T @ jacobian)
    assert np.abs(left).max() < 1e-9 * np.abs(jacobian).max()
