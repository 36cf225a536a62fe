"""report-uncertainty: GUM and Monte Carlo, from quantities and other jobs' results to an uncertainty and a decision."""

from metrocli.tasks.kind import Kind

KIND = Kind("report-uncertainty", "GUM and Monte Carlo uncertainty, budget, capability", chunked=True)
