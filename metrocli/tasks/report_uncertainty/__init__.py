"""report-uncertainty: uncertainty and decision by GUM and Monte Carlo, from quantities and results of other jobs."""

from metrocli.tasks.kind import Kind

KIND = Kind("report-uncertainty", "GUM and Monte Carlo uncertainty, budget, capability", chunked=True)
