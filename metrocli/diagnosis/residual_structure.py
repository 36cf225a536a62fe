"""Structure in the residuals that no identified effect explains, and the scatter of repeated readings.

Method: docs/algorithms/evidence.md (what is left).
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.distributions import log_tail
from metrocli.frozen import dataclass

REPEATS = "what repeated readings have in common"


@dataclass(frozen=True)
class RemainingStructure:
    """Structure that no known effect explains."""

    p_value: float
    depends_on: tuple[str, ...]
    where: tuple[str, ...] = ()
    """The units (tracers, images) whose readings show it; empty if all do"""
    size: float = 0.0
    """Its visible size: root mean square over those readings, in their unit"""
    share: float | None = None
    """Its share in the squares of held-out errors without the effects; None if none is identified, or if it shows in
    readings of another unit than these errors"""
    beside: float = 0.0
    """Share of errors that vary smoothly beside it, and that are left too"""
    declared: bool = False
    """Whether the noise that the job declares includes it"""
    unit: str = ""
    """Internal unit of these readings; empty for that of the report"""


@dataclass(frozen=True)
class PureError:
    """The noise found from readings that were repeated under the same conditions, independent of the model."""

    ratio: float
    """Ratio of their scatter to the declared noise"""
    dof: float
    lack_of_fit: float
    """Significance level of the remaining residuals compared with that scatter"""


def pure_error(state: State) -> PureError | None:
    """Return the scatter of repeated readings and the F test of the rest of the residuals; None without repetitions.

    `F = ((S - S_pe) / (nu - nu_pe)) / (S_pe / nu_pe)`, the lack-of-fit test (Fisher 1922; NIST e-Handbook 4.4.4.6).
    """
    m = state.measurement
    squares, dof = 0.0, 0.0
    for group in m.job.model.readings:
        label = m.job.replicates.get(group.name)
        if label is not None:
            d, n = group.observations.readings.shape
            start = m.system.first[group.name]
            scatter, freedoms = _within(state.residual[start : start + n * d].reshape(n, d), label)
            squares, dof = squares + scatter, dof + freedoms
    if dof < 1:
        return None
    whole = float(state.residual @ state.residual)
    rest = max(state.noise_freedoms - dof, 1.0)
    # the F test by the share of the squares, as other tests have it: no division by a scatter of 0
    share = np.array(np.clip(1 - squares / max(whole, 1e-300), 0.0, 1.0))
    return PureError(float(np.sqrt(squares / dof)), dof, float(np.exp(log_tail(share, rest, dof))))


def _within(values: Array, label: Index) -> tuple[float, float]:
    """Return the sum of squares of values (n, d) about the means of equal labels, and its degrees of freedom."""
    _, number = np.unique(label, return_inverse=True)
    counts = np.bincount(number)
    means = np.stack([np.bincount(number, column) / counts for column in values.T], axis=1)
    return float(((values - means[number]) ** 2).sum()), float((len(values) - len(counts)) * values.shape[1])
