"""Points that a tracer reads more than once: every table, warning and figure names the reading that it means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simulated import lengths as sim

from metrocli.plots.readings import residuals_of
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate

WRONG = 0.02
"""Error of the second reading of P1 by T2 [mm]"""


def again(outliers: str = "report") -> Result:
    """A network of which six tracers read three points twice, 2000 s later; one of these readings is wrong."""
    net = sim.network(20, 6, 47)
    rng = np.random.default_rng(470)
    table, count = net.lengths(), 18
    columns = {name: np.concatenate([values, values[:count]]) for name, values in table.columns.items()}
    lengths = columns["length"].copy()
    lengths[-count:] += rng.normal(size=count) * sim.NOISE.constant
    at = np.flatnonzero((columns["point"] == columns["point"][6]) & (columns["tracer"] == columns["tracer"][2]))[-1]
    lengths[at] += WRONG
    time = np.concatenate([np.repeat(np.arange(20.0), 6), 2000 + np.arange(float(count))])
    units = {**table.units, "t": "s"}
    whole = Table({**columns, "length": lengths, "t": time}, units, table.file, tuple(range(2, len(time) + 2)))
    settings = replace(sim.settings(), outliers=outliers)
    return multilaterate.run(multilaterate.TASK.job(settings, whole, net.point_table()))


def test_a_wrong_reading_is_named_with_its_time() -> None:
    result = again()
    residuals = result.tables["residuals"]
    rows = list(zip(*(residuals.texts(name) for name in ("point", "tracer", "time")), strict=True))
    assert len(set(rows)) == len(rows) == 138
    suspects = result.tables["suspects"]
    assert suspects.texts("time")[0] == "2008 s"
    assert any(f"({suspects.texts('time')[0]}) (w = " in warning for warning in result.warnings)
    (found,) = residuals_of(result)
    assert "2008 s" in found.name(int(np.nanargmax(np.abs(found.w))))


def test_a_reading_that_is_left_out_is_named_with_its_time() -> None:
    result = again("remove")
    rejected = result.tables["rejected"]
    assert rejected.texts("time") == ["2008 s"]
    assert any("(2008 s)" in warning for warning in result.warnings)


def test_a_network_in_which_nothing_is_read_twice_has_no_times_among_its_keys() -> None:
    net = sim.network(20, 6, 48)
    result = multilaterate.run(multilaterate.TASK.job(sim.settings(), net.lengths(), net.point_table()))
    assert "time" not in result.tables["residuals"] and "time" not in result.tables["suspects"]
