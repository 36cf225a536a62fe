"""report-uncertainty: uncertainty and decision by GUM and Monte Carlo, from quantities and results of other jobs.

`entries` and `values` (keys) -> `quantity`, `correlations` -> `problem` -> propagation and trials of `uncertainty`
-> `decisions` -> `report`; the volume form by `volume_problem` and `volume_report`.
"""

from metrocli.tasks.kind import Kind

KIND = Kind("report-uncertainty", "GUM and Monte Carlo uncertainty, budget, capability", chunked=True)
