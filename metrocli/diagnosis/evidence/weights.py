"""A measurement whose variance groups have a noise of their own.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Knots
from metrocli.diagnosis.linear.candidates import Family
from metrocli.diagnosis.linear.projection import System


def with_noise(measurement: Measurement, ratios: Mapping[int, float]) -> Measurement:
    """Return a measurement in which some variance groups have noise that is so many times as large as before.

    Rows are divided by the ratios. The likelihood of the readings then has the determinants of this change: those of
    the covariance, and of the unknowns' columns.
    """
    factor = np.ones(measurement.system.rows)
    for number, ratio in ratios.items():
        factor[measurement.units[number][2]] /= ratio
    system = measurement.system
    basis, log_det = system.basis.weighted(factor)
    bare = replace(system, basis=basis, scale=system.scale / factor)
    weighted = replace(bare, residual=bare.seen(system.residual * factor))
    known = dict(measurement.noise)
    for number, ratio in ratios.items():
        known[number] = known.get(number, 1.0) * ratio
    return replace(
        measurement,
        system=weighted,
        families=tuple(_weighted(one, weighted, factor) for one in measurement.families),
        scatters=tuple(tuple(_weighted(one, weighted, factor) for one in own) for own in measurement.scatters),
        knots=tuple(_knots(one, weighted, factor) for one in measurement.knots),
        noise=known,
        unweighted=measurement.unweighted or measurement,
        log_scale=measurement.log_scale + float(np.log(factor).sum()) - log_det / 2,
        held={},
    )


def _weighted(family: Family, system: System, factor: Array) -> Family:
    columns = family.columns.weighted(factor)
    return replace(family, columns=columns, raw=columns.norms(), gram=columns.grams(system.basis))


def _knots(knots: Knots, system: System, factor: Array) -> Knots:
    from scipy.sparse import diags

    functions = knots.functions
    columns = (diags(factor) @ functions.columns).tocsr()
    gram = (columns.T @ columns).toarray() - system.basis.gram_of(columns)
    return replace(
        knots,
        functions=replace(functions, columns=columns, gram=gram),
        values=knots.values * factor[:, None],
    )
