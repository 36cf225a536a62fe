"""Further columns of the data as variables of laws: those that differ from all other variables.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.laws.terms import powers_are_tried

_FEWEST = 4
"""Fewest different values of a column"""
_ALIKE = 0.999
"""Correlation above which a column counts as the same variable: as the time, or as the number of the row"""


def kept(values: Mapping[str, Array], of_data: Collection[str]) -> dict[str, Array]:
    """Return the variables (rows,) without columns of the data that have few values or follow another variable.

    The time counts also by its order, so that a column that numbers the readings follows it.
    """
    columns = {name: column for name, column in values.items() if name not in of_data}
    order = {"order": np.unique(columns["t"], return_inverse=True)[1].astype(float)} if "t" in columns else {}
    for name in (column for column in values if column in of_data and powers_are_tried(column)):
        if len(np.unique(values[name])) >= _FEWEST and not _follows(values[name], (columns | order).values()):
            columns[name] = values[name]
    return columns


def _follows(values: Array, others: Collection[Array]) -> bool:
    varying = [other for other in others if np.ptp(other) > 0]
    return any(abs(float(np.corrcoef(values, column)[0, 1])) > _ALIKE for column in varying)
