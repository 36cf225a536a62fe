"""The figures of a result of a align-part job, by name."""

from __future__ import annotations

from metrocli.tasks.align_part.settings import Settings
from metrocli.tasks.figures import POSE, adjusted


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; `gamma_s` is there only with rotated poses or a free clamping angle."""
    statistics = ("readings", "rejected", "images", "noise", "predicted_std_gamma_s", "predicted_correlation_gamma_s")
    return adjusted(POSE | {"gamma_s": "rad"}, statistics, ["px"])
