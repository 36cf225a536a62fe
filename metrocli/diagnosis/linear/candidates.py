"""Candidates: the forms and places of each cause, with the columns that each would add to the model.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.diagnosis.linear.column_parts import OwnColumns, StepColumns
from metrocli.diagnosis.linear.columns import CandidateColumns
from metrocli.diagnosis.linear.projection import VISIBLE, Linearised
from metrocli.diagnosis.linear.scans import any_apart, is_filled, sketch_vectors
from metrocli.diagnosis.linear.signatures import scan
from metrocli.effects.effect import Effect
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Candidate:
    """One form of a cause at one place."""

    effect: Effect
    instance: tuple[str, ...]
    scanned: tuple[tuple[str, float], ...] = ()
    parameters: tuple[str, ...] = ()
    """Parameters, one for each of its columns, in order"""
    named: tuple[tuple[str, str], ...] = ()
    """Scanned parameters that are places: parameter and name of the place"""

    @property
    def where(self) -> dict[str, str]:
        """The place as a job names it, without scanned parameters."""
        named = dict(zip(self.effect.keys, self.instance, strict=True))
        return named | ({"by": self.effect.by} if "by" in self.effect.where else {})

    @property
    def spot(self) -> tuple[str, tuple[str, ...]]:
        """Cause and place, without the form and the values of scanned parameters."""
        return self.effect.name, self.instance

    @property
    def form(self) -> tuple[str, tuple[str, ...], str]:
        """Cause, place and form (by time, by temperature), without the values of scanned parameters."""
        return *self.spot, self.effect.by

    def signature(self, system: Linearised) -> Array:
        """Return its whitened columns, (rows, parameters)."""
        full, _, _ = next(scan(system, self.effect, [self.instance], [dict(self.scanned)]))
        return full

    def like(self, other: Candidate) -> bool:
        """Return whether it differs from another alternative in the values of scanned parameters at most."""
        return (self.form, self.parameters, self.named) == (other.form, other.parameters, other.named)

    @property
    def words(self) -> str:
        """Cause, form and place in words."""
        return " ".join([self.effect.form, *self.instance, *(f"{key} {name}" for key, name in self.named)])

    def __str__(self) -> str:
        return " ".join([self.effect.name, *self.instance, *(f"{key} {name}" for key, name in self.named)])


@dataclass(frozen=True)
class CandidateGroup:
    """A cause with all its alternatives that have the same number of columns."""

    name: str
    alternatives: tuple[Candidate, ...]
    columns: CandidateColumns
    """The whitened signatures"""
    raw: Array
    """Norm of each whole whitened signature, (alternatives, parameters)"""
    gram: Array
    """`G'MG` of each alternative, (alternatives, parameters, parameters)"""
    unknown: str = ""
    """Covariate of a family whose cause is not known; "" for effects"""
    whole: Mapping[int, OwnColumns | StepColumns] = field(default_factory=dict)
    """Whole signatures of the alternatives whose columns are their visible parts"""

    @property
    def effect(self) -> Effect:
        """The effect of its first alternative; others may be other forms of it."""
        return self.alternatives[0].effect

    @property
    def form(self) -> tuple[str, int, int]:
        """Name, number of alternatives and number of columns of each, by which families of other tests are matched."""
        return self.name, self.columns.count, self.columns.parameters

    @property
    def shown(self) -> Mask:
        """Which columns the unknowns do not absorb wholly, as they do the places of free targets, (alternatives, q)."""
        return np.asarray(np.einsum("kqq->kq", self.gram) > (VISIBLE * self.raw) ** 2)

    def only(self, chosen: Sequence[int]) -> CandidateGroup:
        """Return it with some of its alternatives, which are numbered anew."""
        alternatives = tuple(self.alternatives[number] for number in chosen)
        some: Index = np.asarray(chosen, dtype=np.intp)
        return replace(
            self,
            alternatives=alternatives,
            columns=self.columns.only(chosen),
            raw=self.raw[some],
            gram=self.gram[some],
            whole={at: self.whole[number] for at, number in enumerate(chosen) if number in self.whole},
        )

    def changes(self, gram: Array, right: Array) -> Array:
        """Return the norm of each alternative, (alternatives,), at its best size; columns count as orthogonal."""
        sizes = np.linalg.pinv(gram, hermitian=True) @ right[:, :, None]
        return np.asarray(np.linalg.norm(sizes[:, :, 0] * self.raw, axis=1))

    def absorbed_by(self, system: Linearised, chosen: Sequence[int]) -> Array:
        """Return the coordinates of what the unknowns absorb of some alternatives, (unknowns, chosen, parameters)."""
        full = self.columns.whole(chosen, system.rows)
        for at, number in enumerate(chosen):
            if number in self.whole:
                full[:, at] = 0.0
                full[self.whole[number].rows, at] = self.whole[number].values
        return system.basis.coordinates(full)

    def has_gaps(self, system: Linearised, chosen: Sequence[int]) -> bool:
        """Return whether the scan of a cause at one place, by its alternatives, misses forms between its values."""
        effect = self.alternatives[chosen[0]].effect
        if not is_filled(effect):
            return False
        name = effect.scanned[0].name
        ordered = sorted(chosen, key=lambda at: dict(self.alternatives[at].scanned)[name])
        return any_apart(self.columns.products(sketch_vectors(system), ordered))


@dataclass(frozen=True)
class NotTested:
    """An effect that cannot be tested, with the reason; with a place if it can be tested at other places."""

    effect: Effect
    reason: str
    where: Mapping[str, str] = field(default_factory=dict)
