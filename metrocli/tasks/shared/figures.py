"""The figures of a result by name, known before it is computed, so that a typo in `require:` is found at once.

Each kind lists its own beside its settings: a mapping from the name to the internal unit, "" for a plain number. What
only the files of a job name, such as a tracer, stands in braces: `{tracer}.x`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrocli.effects.requested import RequestedEffect

_ADJUSTMENT = ("observations", "unknowns", "conditions", "dof", "sigma0", "chi2", "p_value", "iterations")
_NOISE_FOUND = ("noise_estimated", "clusters", "inflation")
POSE = {"x": "mm", "y": "mm", "z": "mm", "alpha": "rad", "beta": "rad", "gamma": "rad"}
"""The estimated position and angles of a frame"""


def adjusted(estimates: Mapping[str, str], statistics: Iterable[str], rms: Iterable[str]) -> dict[str, str]:
    """Return the figures of an adjustment: its estimates by unit, and statistics, with an RMS for each unit in `rms`.

    Among them are those that it has with some settings only, such as those of estimated noise.
    """
    names = (*_ADJUSTMENT, *(f"rms.{unit}" for unit in rms), *statistics, *_NOISE_FOUND)
    return with_std(estimates) | dict.fromkeys(names, "")


def with_std(estimates: Mapping[str, str]) -> dict[str, str]:
    """Return estimates, by unit, with their standard uncertainties and degrees of freedom."""
    return {
        name: kept
        for estimate, unit in estimates.items()
        for name, kept in ((estimate, unit), (f"{estimate}.std", unit), (f"{estimate}.dof", ""))
    }


def of_effects(effects: Sequence[RequestedEffect]) -> dict[str, str]:
    """Return the estimated parameters of the effects that a job adds, named as in `metrocli.effects.estimates`."""
    figures: dict[str, str] = {}
    names = [effect.name for effect in effects]
    for effect in effects:
        labels = [effect.name, *([f"{effect.name} {{number}}"] if names.count(effect.name) > 1 else [])]
        for form in effect.forms if not effect.std else ():
            places = (*labels, f"{effect.name}.{{place}}") if form.where else labels
            free = [p for p in form.all_parameters if p.name not in effect.values]
            figures |= {f"{place}.{p.name}": p.unit for place in places for p in free}
    return with_std(figures)
