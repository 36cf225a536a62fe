"""The figures of a result of a fit-part job, by name."""

from __future__ import annotations

from metrocli.tasks.figures import POSE, with_std
from metrocli.tasks.fit_part.settings import Settings

_STATISTICS = (
    "observations", "unknowns", "dof", "iterations", "minimum", "least_overstock", "mean_overstock",
    "largest_overstock", "variation", "largest_least_overstock", "optimality", "active", "rejected", "targets",
    "monte_carlo_trials", "monte_carlo_failed",
)  # fmt: skip


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures."""
    return with_std(POSE) | dict.fromkeys(_STATISTICS, "")
