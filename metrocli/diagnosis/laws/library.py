"""The library of terms for a job: where each can act, and the columns that it adds to the linearised system.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.laws.terms import Form, forms_of
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.columns import gathered
from metrocli.diagnosis.linear.projection import System
from metrocli.effects.acting import Acting
from metrocli.effects.effect import Effect, Parameter

_ELAPSED = ("t", "T")
_MOST_PLACES = 40
MOST_NUMBERS = 8_000_000
"""Largest number of elements of all columns"""
_SAME = 1e-9
"""Two components of quantities act alike if their squared correlation is nearer to 1 than this"""
_EFFECT = Effect("law", "", (Parameter("size"),))


Where = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Spot:
    """A component of a quantity at a place, where terms act."""

    acting: Acting
    component: str
    where: Where
    """Kind of place and its name; empty for all readings"""


@dataclass(frozen=True)
class Term:
    """A form at a spot."""

    spot: Spot
    form: Form

    @property
    def place(self) -> tuple[str, Where]:
        """The quantity and the place; all terms of one law share it."""
        return self.spot.acting.name, self.spot.where

    def at(self, scanned: float) -> Term:
        """Return the term with another scanned value."""
        return replace(self, form=replace(self.form, scanned=scanned))


@dataclass(frozen=True)
class _Carrier:
    """Whitened change of the readings by a unit change at a spot, (rows,), and the variables there by name."""

    spot: Spot
    change: Array
    values: dict[str, Array]


class Library:
    """All terms for a job about a linearised system."""

    def __init__(self, job: AdjustedJob, system: System) -> None:
        self.system = system
        self._carriers = list(_carriers(job, system))
        self.terms: list[tuple[Term, ...]] = []
        """The terms of each family, in the order of its alternatives"""

    def families(self) -> list[Family]:
        """Return one family for each form and number of columns, with as many periods as the memory allows."""
        for periods in (59, 29, 15, 7):
            forms = [(carrier, list(_forms(carrier, periods))) for carrier in self._carriers]
            count = sum(len(form.factors) for _, found in forms for form in found)
            if count * self.system.rows <= MOST_NUMBERS:
                break
        else:
            forms = [(carrier, found) for carrier, found in forms if not carrier.spot.where]
        by_kind: dict[tuple[str, int], list[tuple[Term, _Carrier]]] = {}
        for carrier, found in forms:
            for form in found:
                term = Term(carrier.spot, form)
                by_kind.setdefault((form.kind, len(form.factors)), []).append((term, carrier))
        families = []
        for (kind, _), items in by_kind.items():
            columns = gathered((id(carrier), *_at_rows(carrier, term.form)) for term, carrier in items)
            self.terms.append(tuple(term for term, _ in items))
            alternatives = tuple(Alternative(_EFFECT, (str(number),)) for number in range(columns.count))
            absorbed = np.zeros((0, columns.count, columns.parameters))
            families.append(Family(kind, alternatives, columns, columns.norms(), absorbed))
        return families

    def columns(self, term: Term) -> Array:
        """Return the whitened columns of a term, (rows, factors)."""
        carrier = next(one for one in self._carriers if one.spot == term.spot)
        return _columns(carrier, term.form)


def _forms(carrier: _Carrier, periods: int) -> Iterator[Form]:
    here = carrier.change != 0
    values = {name: one[here] for name, one in carrier.values.items() if np.ptp(one[here]) > 0}
    elapsed = {name: values[name] for name in _ELAPSED if name in values}
    return forms_of(values, {name: one for name, one in elapsed.items() if name == "t"}, periods)


def _at_rows(carrier: _Carrier, form: Form) -> tuple[Index, Array]:
    """Return the rows that the carrier changes, and the columns of a form there."""
    rows = np.flatnonzero(carrier.change)
    values = {name: one[rows] for name, one in carrier.values.items()}
    return rows, form.columns(values) * carrier.change[rows, None]


def _columns(carrier: _Carrier, form: Form) -> Array:
    return form.columns(carrier.values) * carrier.change[:, None]


def _carriers(job: AdjustedJob, system: System) -> Iterator[_Carrier]:
    found: list[Array] = []
    for acting in job.places:
        whole, values = _at(job, system, acting)
        for number, name in enumerate(acting.components):
            change = whole[:, number]
            if not np.abs(change).max(initial=0.0) > 0 or _alike(change, found):
                continue
            found.append(change)
            yield _Carrier(Spot(acting, name, ()), change, values)
            for key in acting.where:
                if key in job.units:
                    yield from _at_places(job, system, Spot(acting, name, ()), key, change, values)


def _at_places(
    job: AdjustedJob, system: System, spot: Spot, key: str, change: Array, values: dict[str, Array]
) -> Iterator[_Carrier]:
    place = job.model.places[key]
    if len(place.names) > _MOST_PLACES:
        return
    for number, name in enumerate(place.names):
        mask = np.zeros(system.rows)
        for group in job.model.readings:
            index = group.observations.index.get(place.index)
            if index is not None:
                mask += system.spread(group, (index == number).astype(float))
        if (mask * change).any():
            yield _Carrier(replace(spot, where=((key, name),)), change * mask, values)


def _alike(change: Array, found: Sequence[Array]) -> bool:
    return any(
        float(change @ other) ** 2 > (1 - _SAME) * float(change @ change) * float(other @ other) for other in found
    )


def _at(job: AdjustedJob, system: System, acting: Acting) -> tuple[Array, dict[str, Array]]:
    """Return the whitened change of all rows by each component (rows, components), and the variables (rows,)."""
    whole = np.zeros((system.rows, len(acting.components)))
    values: dict[str, Array] = {}
    known = acting.variables_at({})
    own = {*acting.components, acting.name} - {"angle"}
    for group in job.model.readings:
        links = group.chain.links
        at = next((i for i in reversed(range(len(links))) if links[i].gives is acting.quantity), None)
        if at is None:
            continue
        run, observations = system.run(group), group.observations
        d, n = observations.readings.shape
        outer, value = run.outer[at + 1], run.values[at + 1]
        by_input = np.eye(d)[:, :, None] if outer is None else outer
        by_input = np.broadcast_to(by_input, (d, len(acting.components), n))
        start = system.first[group.name]
        rows = slice(start, start + d * n)
        factor = observations.deviations.T.ravel() / system.scale[rows]
        whitened = np.moveaxis(observations.whitened(np.array(by_input)), -1, 0).reshape(n * d, -1)
        whole[rows] = whitened * factor[:, None]
        local = Local(job.model.blocks, observations, frozenset())
        for name, one in known.items():
            there = all(need in observations.conditions for need in one.needs)
            if name in own or name.startswith("beam_") or not there:
                continue
            full = np.broadcast_to(one.at(value, local).value[0], (n,))
            if np.isfinite(full).all():
                values[name] = values.get(name, np.zeros(system.rows)) + system.spread(group, np.array(full))
    return whole, values
