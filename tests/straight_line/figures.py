"""The figures of a result of the tests' kind, by name."""

from __future__ import annotations

from metrocli.tasks.figures import with_std
from straight_line.settings import Settings


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures."""
    statistics = ("observations", "unknowns", "dof", "sigma0", "rms.mm")
    return with_std({"slope": "rad", "offset": "mm"}) | dict.fromkeys(statistics, "")
