"""A law that was found: its terms with their sizes, what it explains, and its data beside it.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.gain import Gain
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.laws.library import Library, Term
from metrocli.diagnosis.laws.steps import Lawful
from metrocli.diagnosis.laws.terms import columns_of
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass

_SEEN, _STEPS = 0.5, 400
"""Least change of a reading that is shown beside a law, of that of the most changed; steps of the curve of a law"""
_UNDONE = 0.5
"""Share of a coordinate that no cause adds to it"""
_LEAST, _MOST = 0.9, 2
"""Smallest cosine of an effect that is reported as nearly the law, and the largest number of them"""


@dataclass(frozen=True)
class LawData:
    """A law beside the readings in which it was found, (n,) each; those of one component of one reading a row.

    A law of one variable that adds to one component is a curve. Readings are then converted into changes of the
    component: divided by their change with it. Those that change less than half as much as the most are left out. Any
    other law stands over what it adds to the readings. Of readings in several units, those that show most of the law
    are here.
    """

    variable: str
    """Empty for a law that is not a curve"""
    unit: str
    x: Array
    """The variable, or what the law adds"""
    law: Array
    """What the law adds to the component, or to the readings"""
    residual: Array
    """Residuals of the job extended by the law, plus what it adds (component plus residual)"""
    adds_unit: str
    """Internal unit of the component, or of the readings"""
    curve: tuple[Array, Array] | None
    """The law at equal steps of its variable: variable and law"""


@dataclass(frozen=True)
class Law:
    """A sum of terms on one quantity at one place."""

    terms: tuple[Term, ...]
    sizes: tuple[Array, ...]
    """Coefficient of each factor of each term, in internal units"""
    stds: tuple[Array, ...]
    p_value: float
    """exp of minus the net evidence of its least term beside the others"""
    gain: Gain
    part_of_structure: float
    """Share of the squares that it explains, of those above the noise"""
    size: float
    """Root mean square of what it explains over the readings on which it acts, in their unit"""
    data: LawData | None
    """None for a constant, which has no variable"""
    near: tuple[tuple[Candidate, float], ...] = ()
    """Effects of the catalogue that change the readings nearly as it does, each with the cosine, the nearest first"""
    replaced: tuple[Candidate, ...] = ()
    """Effects that were identified before it was found, and that it replaces"""
    as_likely: tuple[Term, ...] = ()
    """Single terms of other variables, or at other places, that explain the readings as well as its only one.

    The best comes first.
    """
    chosen: bool = False

    @property
    def undoes_positions(self) -> bool:
        """Whether it adds much of a coordinate to this one, as `x += X`: it undoes positions that are wrong."""
        return any(
            term.form.powers_of() == {term.spot.component.upper(): 1} and abs(size[0]) > _UNDONE
            for term, size in zip(self.terms, self.sizes, strict=True)
        )


def law_of(lawful: Lawful, base: State, gain: Gain, instead: State) -> Law:
    library, terms, state = lawful.library, lawful.terms, lawful.state
    system = base.measurement.system
    whole = np.concatenate([library.columns(term) for term in terms], axis=1)
    left = base.seen(whole)
    # columns of unit length: powers of a variable differ by many decades, and the cut of the pseudo-inverse is relative
    scale = np.maximum(np.sqrt(np.maximum((whole * left).sum(axis=0), 0.0)), 1e-300)
    inverse = np.linalg.pinv((whole / scale).T @ (left / scale), rcond=1e-10, hermitian=True)
    sizes = inverse @ ((whole / scale).T @ base.residual) / scale
    stds = np.sqrt(np.maximum(np.diag(inverse), 0.0) * state.variance) / scale
    cuts = np.cumsum([len(term.form.factors) for term in terms])[:-1]
    acting = whole.any(axis=1)
    shown = np.where(acting & system.in_reported_unit, (base.residual - state.residual) * system.scale, 0.0)
    # the smaller of both variances: the share is of what is above the noise, and structure left over is not noise
    noise = min(state.variance, instead.variance) * base.freedoms
    part = (base.fit.squares - state.fit.squares) / max(base.fit.squares - noise, 1e-300)
    nets = state.without_fixed()[-len(terms) :]
    return Law(
        terms,
        tuple(np.split(sizes, cuts)),
        tuple(np.split(stds, cuts)),
        float(np.exp(-max(float(nets.min()), 0.0))),
        gain,
        float(np.clip(part, 0.0, 1.0)),
        float(np.sqrt((shown[shown != 0] ** 2).mean())) if shown.any() else 0.0,
        _data(library, terms, whole @ sizes, sizes, state.residual),
        near_effects(base, left @ sizes),
    )


def _data(library: Library, terms: Sequence[Term], adds: Array, sizes: Array, after: Array) -> LawData | None:
    """Return a law over its variable, beside the readings to which it adds; `after` is the residual with it (rows,)."""
    system, spot = library.system, terms[0].spot
    variables = {name for term in terms for name in term.form.variables}
    if not variables:
        return None
    law = adds * system.scale
    residual = law + after * system.scale
    unit_of_readings, showing = system.showing(adds)
    if len(variables) > 1 or any(term.spot.component != spot.component for term in terms):
        rows = np.flatnonzero((adds != 0) & showing)
        return LawData("", "", law[rows], law[rows], residual[rows], unit_of_readings, None)
    (name,) = variables
    change = np.where(showing, library.change(spot) * system.scale, 0.0)
    rows = np.flatnonzero((change != 0) & (np.abs(change) >= _SEEN * np.abs(change).max()))
    x = library.values(terms, name)[rows]
    steps = np.linspace(x.min(), x.max(), _STEPS)
    factors = [columns_of([term.form], {name: steps})[:, 0] for term in terms]
    curve = np.concatenate([np.broadcast_to(factor, (_STEPS, factor.shape[1])) for factor in factors], axis=1) @ sizes
    # divided by the change per unit of the component: each reading shows the law itself
    law, residual = law[rows] / change[rows], residual[rows] / change[rows]
    unit, adds_unit = spot.acting.variables_at({})[name].unit, spot.acting.unit_of(spot.component)
    return LawData(name, unit, x, law, residual, adds_unit, (steps, curve))


def near_effects(state: State, shown: Array) -> tuple[tuple[Candidate, float], ...]:
    """Return the effects whose visible columns nearly contain what a law explains, (rows,), with the cosine.

    Each is at its best place and with its best scanned values; the nearest comes first.
    """
    size, nearest = float(shown @ shown), dict[str, tuple[Candidate, float]]()
    for number, family in ((at, one) for at, one in enumerate(state.measurement.families) if not one.unknown):
        # beside wrong readings too, of which what the law explains is free
        inside, _ = quadratic(state.left(number)[0], family.columns.products(shown[:, None])[:, :, 0], family.raw)
        best = int(np.argmax(inside))
        cosine = float(np.sqrt(min(inside[best] / max(size, 1e-300), 1.0)))
        before = nearest[family.name][1] if family.name in nearest else _LEAST
        if cosine > before:
            nearest[family.name] = family.alternatives[best], cosine
    return tuple(sorted(nearest.values(), key=lambda pair: -pair[1])[:_MOST])
