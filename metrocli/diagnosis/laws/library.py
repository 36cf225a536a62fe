"""The library of terms for a job: where each can act, and the columns that it adds to the linearised system.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import count, groupby

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import LinkContext
from metrocli.adjust.model.groups import listed_values
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.prices import Prices, counted
from metrocli.diagnosis.laws.terms import TermForm, columns_of, forms_of, kept, powers_are_tried, turns_of
from metrocli.diagnosis.linear.candidates import Candidate, CandidateGroup
from metrocli.diagnosis.linear.column_parts import StackedColumns
from metrocli.diagnosis.linear.columns import CandidateColumns
from metrocli.diagnosis.linear.projection import VISIBLE, Linearised, run_of
from metrocli.effects.acting import Acting
from metrocli.effects.effect import Effect, Parameter
from metrocli.frozen import dataclass

_ELAPSED = ("t",)
"""Variables that begin at 0 and grow: they saturate and step"""
_MOST_PLACES = 40
MOST_NUMBERS = 8_000_000
"""Largest number of elements of all columns"""
_PERIODS = (59, 29, 15, 7)
"""Numbers of periods that are tried, the largest for which there is memory: up to 30, 15, 8 or 4 waves over a range"""
_SAME = 1e-9
"""Two components of quantities act alike if their squared correlation is nearer to 1 than this"""
_SHOWS = 1e-3
"""Least share of a term that is visible. Its size is more than a thousand times what shows if the unknowns take more,
and its second order, which derivatives do not have, may be as large as that"""
_ESTIMATED = 0.5
"""Largest part of the spread of a variable that comes from corrections of listed values"""
_SEED = 17
_EFFECT = Effect("law", "", (Parameter("size"),))


Place = tuple[str, str]
"""Kind of place and its name"""
Where = tuple[Place, ...]


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
    form: TermForm

    @property
    def place(self) -> tuple[str, Where]:
        """The quantity and the place; all terms of one law share it."""
        return self.spot.acting.name, self.spot.where

    def is_like(self, other: Term) -> bool:
        """Return whether another term differs in its scanned value at most."""
        return (self.spot, self.form.kind, self.form.factors) == (other.spot, other.form.kind, other.form.factors)

    def at(self, scanned: float) -> Term:
        """Return the term with another scanned value."""
        return replace(self, form=replace(self.form, scanned=scanned))


@dataclass(frozen=True)
class _Carrier:
    """Whitened change of the readings by a unit change at a spot, and the variables there by name, at the rows (r,)."""

    spot: Spot
    rows: Index
    change: Array
    values: dict[str, Array]

    @classmethod
    def of(cls, spot: Spot, change: Array, values: Mapping[str, Array]) -> _Carrier:
        """Return what a change of all rows (rows,) is where it is not zero."""
        rows = np.flatnonzero(change)
        return cls(spot, rows, change[rows], {name: column[rows] for name, column in values.items()})

    @cached_property
    def _varying(self) -> dict[str, Array]:
        return {name: column for name, column in self.values.items() if np.ptp(column) > 0}

    def forms(self, periods: int) -> list[TermForm]:
        """Return the forms of the variables that vary here."""
        elapsed = {name: self._varying[name] for name in _ELAPSED if name in self._varying}
        return list(forms_of(self._varying, elapsed, periods))

    @cached_property
    def _without_waves(self) -> int:
        return sum(len(form.factors) for form in self.forms(0))

    def numbers(self, periods: int) -> int:
        """Return how many numbers the columns of its forms have: counted, since making forms takes longer."""
        smooth = (column for name, column in self._varying.items() if powers_are_tried(name))
        return len(self.rows) * (self._without_waves + 2 * sum(len(turns_of(column, periods)) for column in smooth))

    def columns(self, forms: Sequence[TermForm]) -> Array:
        """Return the whitened columns of forms of one kind, (r, forms, factors)."""
        return columns_of(forms, self.values) * self.change[:, None, None]


class Library:
    """The terms for a job about a linearised system: of all readings, and of single places, all of them or some."""

    def __init__(self, job: AdjustedJob, system: Linearised, places: Collection[Place] | None = None) -> None:
        self.job, self.system = job, system
        every = {place for acting in job.places for place in _places(job, acting)}
        self.places = frozenset(every if places is None else places)
        """Kinds and names of the places where terms may act"""
        self._parts: list[Library] = []
        self.terms: list[tuple[Term, ...]] = []
        """The terms of each family, in the order of its alternatives"""
        self.numbers = count(1_000_000)
        """Numbers of terms at refined values, each once: products are kept by them"""

    @cached_property
    def _carriers(self) -> list[_Carrier]:
        return list(_carriers(self.job, self.system, self.places))

    def at(self, places: Collection[Place]) -> Library:
        """Return the terms of all readings and of some places at least."""
        library = next((part for part in (*self._parts, self) if part.places.issuperset(places)), self)
        if library is self and self.places.difference(places):
            library = Library(self.job, self.system, places)
            # no number twice: the measurement keeps products by it
            library.numbers = self.numbers
            self._parts.append(library)
        return library

    @cached_property
    def families(self) -> tuple[CandidateGroup, ...]:
        """One family for each form and number of columns, with as many periods as the memory allows."""
        by_kind: dict[tuple[str, int], list[tuple[_Carrier, list[TermForm]]]] = {}
        for carrier, forms in self._forms():
            for kind, alike in groupby(sorted(forms, key=_kind_of), key=_kind_of):
                by_kind.setdefault(kind, []).append((carrier, list(alike)))
        return tuple(self._family(*kind, items) for kind, items in by_kind.items())

    @cached_property
    def prices(self) -> Prices:
        """What terms pay, by the number of independent tests of each form."""
        return counted(self.system, self.families, 1, np.random.default_rng(_SEED))

    def _forms(self) -> list[tuple[_Carrier, list[TermForm]]]:
        for periods in _PERIODS:
            # a term at one place has the rows of its readings only
            if sum(carrier.numbers(periods) for carrier in self._carriers) <= MOST_NUMBERS:
                return [(carrier, carrier.forms(periods)) for carrier in self._carriers]
        # even so too many: then no law of a single place is sought
        return [(carrier, carrier.forms(_PERIODS[-1])) for carrier in self._carriers if not carrier.spot.where]

    def _family(self, kind: str, factors: int, items: Sequence[tuple[_Carrier, list[TermForm]]]) -> CandidateGroup:
        parts, terms = list[StackedColumns](), list[Term]()
        for carrier, forms in items:
            numbers = np.arange(len(terms), len(terms) + len(forms))
            parts.append(StackedColumns(carrier.rows, carrier.columns(forms), numbers))
            terms += [Term(carrier.spot, form) for form in forms]
        self.terms.append(tuple(terms))
        columns = CandidateColumns(len(terms), factors, tuple(parts))
        alternatives = tuple(Candidate(_EFFECT, (str(number),)) for number in range(len(terms)))
        # a thousand times too large: then a term of which less than a thousandth shows counts as absorbed
        scale = columns.norms() * (_SHOWS / VISIBLE)
        return CandidateGroup(kind, alternatives, columns, scale, columns.grams(self.system.basis))

    def columns(self, term: Term) -> Array:
        """Return the whitened columns of a term, (rows, factors)."""
        carrier = next(carrier for carrier in self._carriers if carrier.spot == term.spot)
        full = np.zeros((self.system.rows, len(term.form.factors)))
        full[carrier.rows] = carrier.columns([term.form])[:, 0]
        return full

    def change(self, spot: Spot) -> Array:
        """Return the whitened change of all rows by a unit change at a spot, (rows,)."""
        full = np.zeros(self.system.rows)
        for carrier in self._carriers:
            if carrier.spot == spot:
                full[carrier.rows] = carrier.change
        return full

    def values(self, terms: Sequence[Term], variable: str) -> Array:
        """Return a variable in all rows on which terms act (rows,); nan in all others."""
        spots = [term.spot for term in terms]
        full = np.full(self.system.rows, np.nan)
        for carrier in self._carriers:
            if carrier.spot in spots and variable in carrier.values:
                full[carrier.rows] = carrier.values[variable]
        return full


def _kind_of(form: TermForm) -> tuple[str, int]:
    return form.kind, len(form.factors)


def _places(job: AdjustedJob, acting: Acting) -> Iterator[Place]:
    for key in acting.where:
        if key in job.units and len(job.model.places[key].names) <= _MOST_PLACES:
            yield from ((key, name) for name in job.model.places[key].names)


def _carriers(job: AdjustedJob, system: Linearised, places: Collection[Place]) -> Iterator[_Carrier]:
    columns: list[Array] = []
    for acting in job.places:
        whole, values = _at(job, system, acting)
        for number, name in enumerate(acting.components):
            change = whole[:, number]
            # a component that changes the readings as an earlier one does has no law of its own
            if not np.abs(change).max(initial=0.0) > 0 or _alike(change, columns):
                continue
            columns.append(change)
            yield _Carrier.of(Spot(acting, name, ()), change, values)
            for where in (place for place in _places(job, acting) if place in places):
                own = change * system.rows_at(dict([where]))
                if own.any():
                    yield _Carrier.of(Spot(acting, name, (where,)), own, values)


def _alike(change: Array, earlier: Sequence[Array]) -> bool:
    return any(
        float(change @ other) ** 2 > (1 - _SAME) * float(change @ change) * float(other @ other) for other in earlier
    )


def _at(job: AdjustedJob, system: Linearised, acting: Acting) -> tuple[Array, dict[str, Array]]:
    """Return the whitened change of all rows by each component (rows, components), and the variables (rows,)."""
    whole = np.zeros((system.rows, len(acting.components)))
    values: dict[str, Array] = {}
    known = acting.variables_at({})
    listed = listed_values(job.model.blocks, job.model.groups)
    own, partly = {*acting.components, acting.name} - {"angle"}, set[str]()
    for group in job.model.readings:
        links = group.chain.links
        # the last link that gives it: links of effects give it again, behind the one that makes it
        at = next((i for i in reversed(range(len(links))) if links[i].gives is acting.quantity), None)
        if at is None:
            continue
        run, observations = system.run(group), group.observations
        d, n = observations.readings.shape
        outer, value = run.outer[at + 1], run.values[at + 1]
        by_input = np.eye(d)[:, :, None] if outer is None else outer
        by_input = np.broadcast_to(by_input, (d, len(acting.components), n))
        whitened = np.moveaxis(observations.whitened(np.array(by_input)), -1, 0).reshape(n * d, -1)
        # whitened readings are in their own deviations; the rows of the system may have weights besides
        whole[system.stretch(group)] = whitened * system.weights_of(group)[:, None]
        local = LinkContext(job.model.blocks, observations, frozenset())
        before = LinkContext(listed, observations, frozenset())
        value_listed = run_of(group, listed).values[at + 1] if listed is not job.model.blocks else value
        for name, variable in known.items():
            there = observations.conditions.keys() >= set(variable.needs) and job.model.blocks.keys() >= set(
                variable.blocks
            )
            if name in own or name.startswith("beam_") or not there:
                partly.add(name)
                continue
            full = np.broadcast_to(variable.at(value, local).value[0], (n,))
            moved = full - variable.at(value_listed, before).value[0]
            # the height of a target of a flat board is what the residuals made of it
            if np.isfinite(full).all() and moved.std() <= _ESTIMATED * full.std():
                values[name] = values.get(name, np.zeros(system.rows)) + system.spread(group, np.array(full))
            else:
                partly.add(name)
    acting_on = np.flatnonzero(whole.any(axis=1))
    # lengths may have no time beside sightings that have one: there a formula has no value, not that of 0
    seen = {name: column[acting_on] for name, column in values.items() if name not in partly}
    chosen = kept(seen, {name for name, variable in known.items() if variable.of_data})
    return whole, {name: values[name] for name in chosen}
