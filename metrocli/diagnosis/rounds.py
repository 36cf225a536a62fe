"""Rounds: the job is adjusted with the effects that dominate, and the search begins again about that solution.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.clusters.robust import STRUCTURED
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.identified import all_identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.refined import refined
from metrocli.diagnosis.evidence.search import forward, pruned, swapped
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.extended_fit import extended_fit, relinearised
from metrocli.errors import UndeterminedError

_ROUNDS = 4
_DOMINANT, _MANY = 4.0, 50
"""Effects are dominant if they lower the mean square by this factor, with at least so many degrees of freedom"""
_MOST_OF_IT = 0.01
"""Share of all that was gained by which a move must raise the score in a quick search"""


def is_dominated(state: State) -> bool:
    """Return whether most of the misfit comes from effects with which the unknowns are not adjusted yet.

    Signatures are derivatives. The higher-order terms of a large effect would look like other effects, so the search
    stops until the unknowns are adjusted with it. So it does at an effect that is columns of the job's own blocks, such
    as a term of a lens: it bends beside the others, and only about its own solution differs from those that look alike
    (docs/decisions/264-terms-of-a-lens-bend.md).
    """
    m = state.measurement
    new = [part for part in state.named if m.alternative(part.key).spot not in m.job.adjusted]
    # with few degrees of freedom any effect lowers the mean square so far
    if not new or m.dof < _MANY:
        return False
    old = [part for part in state.named if part not in new]
    if any(m.alternative(part.key).effect.link is None for part in new):
        return True
    return State.of(m, old).variance > _DOMINANT * State.of(m, state.named).variance


def searched(job: AdjustedJob, quick: bool = False) -> tuple[State, State]:
    """Return the state of a job as it is, and that of the search about the solution with its dominant effects.

    A quick search looks for no correlated errors and no smooth effects.
    Raises UndeterminedError if no reading is redundant.
    """
    alone = quick and job.noise_model != STRUCTURED  # a job that declares correlated errors has them
    m = measurement_of(job, quick=alone)
    if m.system.dof < 1:
        raise UndeterminedError(
            "the job has no redundant reading, so no reading can contradict its model\n"
            "measure more; `metrocli diagnose --design` shows what a measurement can detect"
        )
    first = state = State.of(m)
    for left in reversed(range(_ROUNDS)):
        # in the last round nothing stops the search: what dominates then is named about the solution that there is
        state = forward(State.of(m), stop=is_dominated if left else None, least=_MOST_OF_IT if quick else 0.0)
        if not left or not is_dominated(state):
            break
        names = all_identified(state, with_rivals=False)
        kept = {group.name: np.ones(group.observations.count, dtype=bool) for group in job.model.readings}
        fit = extended_fit(job, names, kept)
        if fit is None:
            # the job cannot be adjusted with them: then the search goes on beside their first order
            state = forward(state, least=_MOST_OF_IT if quick else 0.0)
            break
        m = measurement_of(relinearised(job, names, fit), None, m, alone)
    return first, pruned(refined(state if quick else swapped(state)))
