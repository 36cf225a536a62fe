"""Readings that a measurement could still make: each of its own once more at the end, or as its kind varies them.

Method: docs/algorithms/next-readings.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import TIME, Index, Observations
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.model import Model
from metrocli.frozen import dataclass

MOST_ROWS = 3000
"""Largest number of components of readings in all proposals; of more proposals evenly spaced ones are taken"""
_TIMES = ("t", ELAPSED)


@dataclass(frozen=True)
class Proposal:
    """Readings that are made together, such as all targets of one image."""

    do: str
    """In words: point P017 once more at the end with LT2"""
    where: Mapping[str, str]
    """Keys of the readings"""
    added: Mapping[str, Observations]
    """Readings that are added, by the name of their group"""

    @property
    def size(self) -> int:
        """Number of components of its readings."""
        return sum(observations.readings.size for observations in self.added.values())


def proposals(job: AdjustedJob) -> list[Proposal]:
    """Return the readings that a job could still make, evenly spaced ones if there are too many."""
    every = list(_all(job))
    rows = sum(proposal.size for proposal in every)
    step = max(1, -(-rows // MOST_ROWS))
    return every[::step]


def _all(job: AdjustedJob) -> Iterator[Proposal]:
    units: dict[tuple[tuple[str, str], ...], dict[str, list[int]]] = {}
    for group in job.model.readings:
        every = [key for key in group.observations.keys if key != TIME]
        keys = [key for key in every if not job.made_together or key in job.made_together]
        named = zip(*(group.observations.keys[key] for key in keys), strict=True)
        for number, names in enumerate(named):
            unit = tuple(zip(keys, names, strict=True))
            units.setdefault(unit, {}).setdefault(group.name, []).append(number)
    span = _duration(job.model)
    for unit, rows in units.items():
        words = _words(unit)
        for when, wait in (("at the end", 0.0), *([(f"after a break of {_in_words(span)}", span)] if span else [])):
            again = {
                name: _later(job.model.group(name), np.array(chosen if job.made_together else chosen[-1:]), wait)
                for name, chosen in rows.items()
            }
            yield Proposal(words.format(f"once more {when}"), dict(unit), again)
        for name, chosen in rows.items() if len(rows) == 1 else ():
            last = _later(job.model.group(name), np.array(chosen if job.made_together else chosen[-1:]), 0.0)
            for how, varied in job.variations(job.model, last):
                yield Proposal(words.format(f"at the end {how}"), dict(unit), {name: varied})


def _duration(model: Model) -> float:
    """Return how long the measurement takes [s]; 0 if its readings have no times."""
    elapsed = [group.observations.conditions.get(ELAPSED) for group in model.readings]
    return max((float(np.ptp(times)) for times in elapsed if times is not None), default=0.0)


def _in_words(seconds: float) -> str:
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"


def _words(unit: Sequence[tuple[str, str]]) -> str:
    (key, name), *others = unit
    beside = f" with {', '.join(name for _, name in others)}" if others else ""
    return f"{key} {name} {{}}{beside}"


def _later(group: Group, rows: Index, wait: float) -> Observations:
    """Return some readings of a group repeated so long [s] after its last one, at the temperature of that one."""
    old = group.observations
    new = old.selected(rows)
    changed = dict(new.conditions)
    for name in _TIMES:
        if name in changed:
            changed[name] = np.full(len(rows), _next(old.conditions[name]) + wait)
    if WARMING in changed and ELAPSED in changed:
        last = int(np.argmax(old.conditions[ELAPSED]))
        changed |= {
            name: np.full(len(rows), old.conditions[name][last]) for name in (WARMING, "temp") if name in changed
        }
    return replace(new, conditions=changed)


def _next(times: np.ndarray) -> float:
    """Return the time one mean step after the last one."""
    different = np.unique(times)
    return float(different[-1] + np.ptp(different) / max(len(different) - 1, 1))


def with_proposals(model: Model, chosen: Sequence[Proposal]) -> Model:
    """Return a model with the readings of proposals after its own, group by group in the order of the proposals."""
    groups = []
    for group in model.groups:
        observations = group.observations
        for proposal in chosen:
            if group.name in proposal.added:
                observations = observations.followed_by(proposal.added[group.name])
        groups.append(group if observations is group.observations else group.with_observations(observations))
    return replace(model, groups=tuple(groups))
