"""Effects of the catalogue that change the readings nearly as a law does: perhaps its cause, at another place.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.quadratics import quadratic

_LEAST, _MOST = 0.9, 2
"""Smallest cosine of an effect that is reported as nearly the law, and the largest number of them"""


def near_effects(state: State, shown: Array) -> tuple[tuple[Candidate, float], ...]:
    """Return the effects whose visible columns nearly contain what a law explains, (rows,), with the cosine.

    Each is at its best place and with its best scanned values; the nearest comes first.
    """
    size, nearest = float(shown @ shown), dict[str, tuple[Candidate, float]]()
    for family in (pair for pair in state.measurement.families if not pair.unknown):
        inside, _ = quadratic(family.gram, family.columns.products(shown[:, None])[:, :, 0], family.raw)
        best = int(np.argmax(inside))
        cosine = float(np.sqrt(min(inside[best] / max(size, 1e-300), 1.0)))
        before = nearest[family.name][1] if family.name in nearest else _LEAST
        if cosine > before:
            nearest[family.name] = family.alternatives[best], cosine
    return tuple(sorted(nearest.values(), key=lambda pair: -pair[1])[:_MOST])
