"""A measurement whose variance groups have a noise of their own.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.likelihood import Products, fit_at, likeliest
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.prices import PRIOR
from metrocli.diagnosis.evidence.reweighted import Reweighted
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import squared
from metrocli.diagnosis.linear.candidates import CandidateGroup
from metrocli.diagnosis.linear.column_parts import OwnColumns
from metrocli.diagnosis.linear.columns import CandidateColumns
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.diagnosis.noise import AS_OTHERS
from metrocli.frozen import dataclass

_ROUNDING = 1e-9


def with_noise(measurement: Measurement, ratios: Mapping[int, float]) -> Measurement:
    """Return a measurement in which some variance groups have noise that is so many times as large as before.

    Rows are divided by the ratios. The likelihood of the readings then has the determinants of this change: those of
    the covariance, and of the unknowns' columns.
    """
    factor = _factor(measurement, ratios)
    own = _system_weighted(measurement, ratios, factor)
    weighted = own.system
    return replace(
        own,
        families=_families(measurement, weighted, factor),
        scatters=tuple(tuple(_weighted(family, weighted, factor) for family in own) for own in measurement.scatters),
        knots=tuple(replace(own, values=own.values * factor[:, None]) for own in measurement.knots),
    )


@dataclass(frozen=True)
class NoiseTrial:
    """A state whose variance groups have other noise."""

    score: float
    ratios: dict[int, float]
    """Ratio of the noise that is found then for each group to that before"""
    others: dict[int, float]
    """Ratios of groups that are watched and have a noise of their own beside these"""
    logs: Array
    """ln of the variances of its random parts"""


def tried_noise(
    state: State, ratios: Mapping[int, float], watched: Sequence[int] = (), logs: Array | None = None
) -> NoiseTrial:
    """Return a state with other noise of some variance groups, so many times as large, and what is found of it then.

    Its parts are those of the state, with other weights: candidates are not looked at. Only the rows of these groups
    are computed anew. The sizes of random parts are sought from `logs` on, or those of the state.
    """
    m = state.measurement
    factor, looked_at = _factor(m, ratios), np.zeros(m.system.rows, dtype=bool)
    for number in (*ratios, *watched):
        looked_at |= m.units[number][2]
    rows = np.flatnonzero(looked_at)
    own_factor = factor[rows]
    other = Reweighted.of(state, rows, own_factor**2 - 1)
    scale = m.log_scale + float(np.log(own_factor).sum()) - other.log_det / 2
    own = replace(m, noise=_noise_after(m, ratios), log_scale=scale)
    most = np.array([part.most for part in state.random])
    fit = likeliest(fit_at(_with_declared(m, other.products), state.logs if logs is None else logs), most)
    after = State(own, state.fixed, state.random, fit)
    absorbed, residual = other.left(fit)
    absorbed, residual = absorbed * own_factor**2, residual * own_factor
    new_ratios, others = dict[int, float](), dict[int, float]()
    for number in (*ratios, *watched):
        there = m.units[number][2][rows]
        freedoms = float(there.sum()) - float(absorbed[there].sum())
        ratio, gain = after.own_noise(freedoms, float((residual[there] ** 2).sum()))
        if number in ratios:
            new_ratios[number] = ratios[number] * ratio
        elif gain > m.price_of_noise and ratio > AS_OTHERS:
            others[number] = ratio
    return NoiseTrial(after.score, new_ratios, others, fit.logs)


def _with_declared(m: Measurement, products: Products) -> Products:
    """Return products with other weights with the squares that the declared noise counts for beside these."""
    k, r = products.unknowns, m.system.residual
    squares = products.squares - m.squares + float(r @ r)
    # what the unknowns alone leave, of which the declared noise counts for a share
    bare = squares - float(products.right[:k] @ np.linalg.solve(products.gram[:k, :k], products.right[:k]))
    return replace(products, squares=squares + PRIOR * min(1.0, bare / max(m.system.dof, 1)))


def _factor(measurement: Measurement, ratios: Mapping[int, float]) -> Array:
    factor = np.ones(measurement.system.rows)
    for number, ratio in ratios.items():
        factor[measurement.units[number][2]] /= ratio
    return factor


def _system_weighted(measurement: Measurement, ratios: Mapping[int, float], factor: Array) -> Measurement:
    """Return a measurement whose rows are multiplied by a factor, but not its candidates."""
    system = measurement.system
    basis, log_det = system.basis.weighted(factor)
    new = replace(system, basis=basis, scale=system.scale / factor, unweighted=system.unweighted or system)
    return replace(
        measurement,
        system=replace(new, residual=new.seen(system.residual * factor)),
        noise=_noise_after(measurement, ratios),
        unweighted=measurement.unweighted or measurement,
        log_scale=measurement.log_scale + float(np.log(factor).sum()) - log_det / 2,
        cache={},
        columns={},
    )


def _noise_after(measurement: Measurement, ratios: Mapping[int, float]) -> dict[int, float]:
    known = dict(measurement.noise)
    for number, ratio in ratios.items():
        known[number] = known.get(number, 1.0) * ratio
        if abs(known[number] - 1) < _ROUNDING:
            del known[number]
    return known


def _families(measurement: Measurement, system: Linearised, factor: Array) -> tuple[CandidateGroup, ...]:
    """Return the families with other weights; the products of those that are small follow from all of them at once."""
    from scipy.sparse import diags

    every, at = measurement.side_by_side
    every = every * factor[:, None] if isinstance(every, np.ndarray) else diags(factor) @ every
    products = squared(every) - system.basis.absorbed_of(every)
    families = []
    for number, family in enumerate(measurement.families):
        if number not in at:
            families.append(_weighted(family, system, factor))
            continue
        shape = family.columns.count, family.columns.parameters
        own, each = products[at[number], at[number]].reshape(*shape, *shape), np.arange(shape[0])
        families.append(_of(family, family.columns.weighted(factor), own[each, :, each], factor))
    return tuple(families)


def _weighted(family: CandidateGroup, system: Linearised, factor: Array) -> CandidateGroup:
    columns = family.columns.weighted(factor)
    return _of(family, columns, columns.grams(system.basis), factor)


def _of(family: CandidateGroup, columns: CandidateColumns, gram: Array, factor: Array) -> CandidateGroup:
    """Return a family with weighted columns of given products; so are whole ones, which have the norms."""
    whole = {at: OwnColumns(own.rows, own.values * factor[own.rows, None]) for at, own in family.whole.items()}
    raw = columns.norms()
    for at, own in whole.items():
        raw[at] = np.linalg.norm(own.values, axis=0)
    return replace(family, columns=columns, raw=raw, gram=gram, whole=whole)
