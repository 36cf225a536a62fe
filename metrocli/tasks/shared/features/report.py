"""Tables of the features through corrected points, with uncertainty from the joint covariance of the points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.shared.features.fit import Criterion, FeatureFit, gradients, least_squares
from metrocli.tasks.shared.features.ideal import NUMBERS, IdealFeature
from metrocli.tasks.shared.features.minimum_zone import minimum_zone
from metrocli.tasks.shared.features.requested import RequestedFeature
from metrocli.tasks.shared.joint_covariance import JointCovariance
from metrocli.tasks.shared.rounding import rounding_of, without_rounding
from metrocli.words import listed

FEATURES, POINTS, COVARIANCE = "features", "features_points", "features_covariance"
_ALL = (*NUMBERS, "form")
_UNITS = {"x": "mm", "y": "mm", "z": "mm", "radius": "mm", "half_angle": "rad", "form": "mm"}
SHOWN = ("feature", "fit", "x", "y", "z", "sx", "sy", "sz", "radius", "s_radius", "form", "s_form")
_READINGS_FIT = 0.0
"""Misfit of the lengths: too few points of a feature are not a reason to read the files in another way"""
_REACH = 3.0
"""Distance of a point from the limit of its zone, in standard deviations, up to which errors can bring it there"""
_WITHOUT = {
    IdealFeature.LINE: ("radius", "half_angle"),
    IdealFeature.PLANE: ("radius", "half_angle"),
    IdealFeature.CIRCLE: ("half_angle",),
    IdealFeature.SPHERE: ("i", "j", "k", "half_angle"),
    IdealFeature.CYLINDER: ("half_angle",),
    IdealFeature.CONE: (),
}
"""Numbers that a shape does not have: nan in the table"""


def fitted(
    wanted: Sequence[RequestedFeature], corrected: Table, joint: JointCovariance
) -> tuple[dict[str, Table], dict[str, Array], Array]:
    """Return the tables of features and of their points, and the covariance of all numbers of all features.

    The covariance (9F, 9F) is in the order of the rows and of x, y, z, i, j, k, radius, half_angle, form. Last are the
    derivatives of these numbers by the unknowns that all points share, (9F, k). Raises
    UndeterminedError or NotConvergedError with the name of the feature.
    """
    if not wanted:
        return {}, {}, np.zeros((0, joint.common.shape[2]))
    points = corrected.stacked("xyz")
    each = [
        (feature, _fit(feature, criterion, points[feature.rows]))
        for feature in wanted
        for criterion in feature.criteria
    ]
    derivative = _derivatives(each, points)
    covariance = joint.propagated(derivative)
    values = np.array([_numbers(fit, points[feature.rows]) for feature, fit in each])
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(values.shape)
    # before numbers that a shape does not have become nan, which would fail every comparison
    _refuse_vague(each, values, std)
    # points without any noise have digits of rounding behind the last one that means something
    exact, rounding = ~std.any(axis=1), rounding_of(points)
    values[exact] = without_rounding(values[exact], rounding)
    absent = np.array([[name in _WITHOUT[feature.shape] for name in _ALL] for feature, _ in each])
    values[absent], std[absent] = np.nan, np.nan
    table = Table.of(
        {
            "feature": [feature.name for feature, _ in each],
            "shape": [str(feature.shape) for feature, _ in each],
            "fit": [str(fit.criterion) for _, fit in each],
            "points": [len(feature.rows) for feature, _ in each],
        }
    )
    for i, name in enumerate(_ALL):
        table = table.joined(
            {f"{name} {_std_of(name)} [{_UNITS.get(name, '')}]": np.stack([values[:, i], std[:, i]], axis=1)}
        )
    optimality = [np.nan if fit.contact is None else fit.contact.optimality for _, fit in each]
    table = table.joined({"optimality": optimality, "may_touch": _exchanges(each, points, joint)})
    by_common = np.asarray(derivative @ joint.common.reshape(points.size, -1))
    return {FEATURES: table, POINTS: _points(each, corrected)}, {COVARIANCE: covariance}, by_common


def estimates_of(tables: Mapping[str, Table]) -> tuple[tuple[Estimate, ...], list[int]]:
    """Return the numbers of features as estimates such as `bore.radius`, and their rows in the covariance.

    Of two fits of one feature, the numbers of the minimum zone are named `bore.minimum-zone.radius`.
    """
    table, kept, estimates = tables[FEATURES], list[int](), list[Estimate]()
    features, fits = table.texts("feature"), table.texts("fit")
    for row, (feature, fit) in enumerate(zip(features, fits, strict=True)):
        both = features.count(feature) > 1 and fit == Criterion.MINIMUM_ZONE
        for at, name in enumerate(_ALL):
            value, std = float(table.numbers(name)[row]), float(table.numbers(_std_of(name))[row])
            if np.isfinite(value):
                kept.append(len(_ALL) * row + at)
                named = f"{feature}.{fit}.{name}" if both else f"{feature}.{name}"
                estimates.append(Estimate(named, value, std, _UNITS.get(name, "1")))
    return tuple(estimates), kept


def figures_of(features: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of the estimates that features may have, by their names."""
    prefixes = [f"{name}{fit}" for name in features for fit in ("", f".{Criterion.MINIMUM_ZONE}")]
    return {f"{prefix}.{number}": _UNITS.get(number, "1") for prefix in prefixes for number in _ALL}


def exchanging(tables: Mapping[str, Table]) -> tuple[str, ...]:
    """Return a note on minimum zones whose points in contact the errors can exchange for others."""
    if FEATURES not in tables:
        return ()
    table = tables[FEATURES]
    rows = zip(table.texts("feature"), table.numbers("may_touch").tolist(), strict=True)
    named = [f"{name} ({number:.0f} more)" for name, number in rows if number > 0]
    if not named:
        return ()
    return (
        f"minimum zones that errors can lay on other points than those in contact: {listed(named, 5)}; their "
        "uncertainties hold the points in contact, and their 95 % intervals cover 92 to 98 % in simulations",
    )


def _exchanges(each: Sequence[tuple[RequestedFeature, FeatureFit]], points: Array, joint: JointCovariance) -> Index:
    """Return how many further points the errors can bring to the limits of each minimum zone, (F,)."""
    covariance, counts = joint.of_points(), np.zeros(len(each), dtype=np.intp)
    for number, (feature, fit) in enumerate(each):
        if fit.contact is None:
            continue
        _, outward = gradients(fit.ideal, points[feature.rows])
        std = np.sqrt(np.einsum("na,nab,nb->n", outward, covariance[feature.rows], outward))
        size = np.abs(fit.deviations)
        near = size.max() - size < _REACH * std
        near[fit.contact.rows] = False
        counts[number] = near.sum()
    return counts


def _std_of(name: str) -> str:
    """Return the column of the standard uncertainty of a number: sx, as in /points, and s_radius."""
    return f"s{name}" if len(name) == 1 else f"s_{name}"


def _fit(feature: RequestedFeature, criterion: Criterion, points: Array) -> FeatureFit:
    try:
        return (least_squares if criterion is Criterion.LEAST_SQUARES else minimum_zone)(feature.shape, points)
    except (UndeterminedError, NotConvergedError) as error:
        raise type(error)(f"feature '{feature.name}': {error}", _READINGS_FIT) from error


def _refuse_vague(each: Sequence[tuple[RequestedFeature, FeatureFit]], values: Array, std: Array) -> None:
    """Raise UndeterminedError for a feature that the errors of its points could move by its own size or turn around."""
    for (feature, fit), number, spread in zip(each, values, std, strict=True):
        # lengths over the size of the feature, angles as they are: 1 is a turn or a move by the whole of it
        reach = np.append(spread[[0, 1, 2, 6]] / fit.ideal.size, spread[[3, 4, 5, 7]])
        if not reach.max() < 1.0:
            moves = [f"its place moves by {1e3 * spread[:3].max():.3g} um"]
            if "i" not in _WITHOUT[feature.shape]:
                moves.append(f"its direction turns by {spread[3:6].max():.3g} rad")
            if "radius" not in _WITHOUT[feature.shape]:
                moves.append(f"its radius of {number[6]:.4g} mm changes by {1e3 * spread[6]:.3g} um")
            raise UndeterminedError(
                f"feature '{feature.name}': the {len(feature.rows)} points do not determine a {feature.shape}: within "
                f"their uncertainty {', '.join(moves)}; points farther apart along and around it would determine it",
                _READINGS_FIT,
            )


def _numbers(fit: FeatureFit, points: Array) -> Array:
    return np.append(np.real(fit.ideal.numbers(points.mean(axis=0))), fit.form)


def _derivatives(each: Sequence[tuple[RequestedFeature, FeatureFit]], points: Array) -> Any:
    """Return the derivative of all numbers by all coordinates, sparse (9F, 3n)."""
    from scipy.sparse import csr_array

    rows, columns, values = [], [], []
    for number, (feature, fit) in enumerate(each):
        derivative = fit.by_points(points[feature.rows]).reshape(len(_ALL), -1)
        at = (3 * feature.rows[:, None] + np.arange(3)).ravel()
        rows.append(np.repeat(len(_ALL) * number + np.arange(len(_ALL)), len(at)))
        columns.append(np.tile(at, len(_ALL)))
        values.append(derivative.ravel())
    shape = (len(_ALL) * len(each), points.size)
    return csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _points(each: Sequence[tuple[RequestedFeature, FeatureFit]], corrected: Table) -> Table:
    """Return the deviation of each point from its feature, and its weight where it is in contact."""
    weights = []
    for feature, fit in each:
        weight = np.zeros(len(feature.rows))
        if fit.contact is not None:
            weight[fit.contact.rows] = fit.contact.weights
        weights.append(weight)
    sizes = [len(feature.rows) for feature, _ in each]
    rows = np.concatenate([feature.rows for feature, _ in each])
    return Table.of(
        {
            "feature": np.repeat([feature.name for feature, _ in each], sizes),
            "fit": np.repeat([str(fit.criterion) for _, fit in each], sizes),
            "point": corrected.columns["point"][rows],
            "deviation [mm]": np.concatenate([fit.deviations for _, fit in each]),
            "contact": np.concatenate(weights),
        }
    )
