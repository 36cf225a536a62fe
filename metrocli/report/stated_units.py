"""Units that the user states for sizes of effects of one's own, such as um/kN, which no dimension has."""

from __future__ import annotations

from metrocli import units
from metrocli.record import Record
from metrocli.result import Estimate, Result


def stated(result: Result, record: Record) -> str:
    """Return the text of the job and the definitions of effects of one's own: where the user states units."""
    defined = (table.texts("define") for name, table in result.tables.items() if name.endswith("/definition"))
    return "\n".join([record.job_text, *(text for texts in defined for text in texts)])


def compound_unit(estimate: Estimate, text: str) -> tuple[float, str]:
    """Return size and symbol of the unit in which a text states an estimate without dimension; else its own unit."""
    known = {units.internal_unit(name) for name in units.DIMENSIONS}
    if estimate.unit in known or "/" in estimate.unit or units.is_inch(estimate.unit):
        return 1.0, estimate.unit
    from metrocli.expressions.dimensions import written

    found = written(text, estimate.unit, estimate.name.rpartition(".")[2])
    return (1.0, estimate.unit) if found is None else (found.factor, found.text)
