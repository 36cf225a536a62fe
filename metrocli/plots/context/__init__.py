"""The context of a result: its diagnosis, the result before an extension, and the files it was made from.

Figures of a result in its context: `before_after` (an extension), `held_out` and `law` (a diagnosis), `lineage`, and
`lens_difference` (two cameras).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrocli import units
from metrocli.frozen import dataclass
from metrocli.plots.magnify import micro
from metrocli.result import Result


@dataclass(frozen=True)
class LineageFile:
    """A file in a lineage."""

    name: str
    kind: str
    """Kind of the job that made it; empty for a file that no job made"""
    sound: bool
    """Whether it is as it was read, and fit for use"""
    needs: tuple[str, ...]
    """Names of the files that it was made from"""


@dataclass(frozen=True)
class ResultContext:
    """What figures show with a result; by default nothing."""

    diagnosis: Mapping[str, Any] | None = None
    """Output of `metrocli diagnose --json` for the job of the result"""
    before: Result | None = None
    """Result of the job without its extension"""
    lineage: tuple[LineageFile, ...] = ()
    """The result itself first"""


ALONE = ResultContext()
"""The context of a result that is shown by itself"""


def chosen_law(diagnosis: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return the law that a diagnosis chose; None without one."""
    return next((law for law in (diagnosis or {}).get("laws", ()) if law.get("chosen")), None)


def law_in_words(law: Mapping[str, Any]) -> str:
    """Return what a law adds, and where."""
    adds = law["adds"]
    text = "; ".join(f"{name}: {term}" for name, term in adds.items()) if isinstance(adds, Mapping) else adds
    return f"{text}, added to {' '.join([law['acts_on'], *law['where'].values()])}"


def sizes_in_words(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the parameters that have a size, with standard uncertainties, each in the unit that suits it."""
    sizes = [
        f"{name} = {_sized(parameter['value'], parameter.get('unit') or '', parameter.get('std'))}"
        for name, parameter in parameters.items()
        if parameter.get("value") is not None
    ]
    uncertain = any(parameter.get("std") is not None for parameter in parameters.values())
    return ", ".join(sizes) + (f" ({units.SPREAD})" if sizes and uncertain else "")


def _sized(value: float, unit: str, std: float | None) -> str:
    size, suited = units.column_unit(abs(value), unit)
    return micro(units.format_quantity(value / size, suited, None if std is None else std / size))
