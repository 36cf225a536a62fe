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
    found = {name: one for name, one in values.items() if name not in of_data}
    order = {"order": np.unique(found["t"], return_inverse=True)[1].astype(float)} if "t" in found else {}
    for name in (one for one in values if one in of_data and powers_are_tried(one)):
        if len(np.unique(values[name])) >= _FEWEST and not _follows(values[name], (found | order).values()):
            found[name] = values[name]
    return found


def _follows(values: Array, others: Collection[Array]) -> bool:
    varying = [one for one in others if np.ptp(one) > 0]
    return any(abs(float(np.corrcoef(values, one)[0, 1])) > _ALIKE for one in varying)
