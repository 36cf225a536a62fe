"""Ideal features through measured points, as they are or after the best fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.fit_points import KIND
from metrocli.tasks.fit_points.listed import listed_points, table_of
from metrocli.tasks.shared.features.fit import least_squares
from metrocli.tasks.shared.features.ideal import UNKNOWNS, IdealFeature
from metrocli.tasks.shared.features.report import COVARIANCE, FEATURES, SHOWN, estimates_of, exchanging, fitted
from metrocli.tasks.shared.features.requested import RequestedFeature
from metrocli.tasks.shared.joint_covariance import JointCovariance
from metrocli.tasks.shared.rounding import rounding_of
from metrocli.units import sized

_NO_NOISE = "its points fit to the rounding of their numbers; nothing shows their noise, so no uncertainty is stated"


@dataclass(frozen=True)
class FeaturePoints:
    """The points of all features, in the frame in which the features are wanted."""

    table: Table
    places: Array
    """(n, 3) mm"""
    own: Array
    """Covariance of each point by its own errors, (n, 3, 3), nan where its noise is to be estimated"""
    common: Array
    """Derivatives by the unknowns that all points share, (n, 3, k)"""
    core: Array
    """Covariance of these unknowns, (k, k)"""


@dataclass(frozen=True)
class FittedFeatures:
    """The part of a result that features make."""

    estimates: tuple[Estimate, ...]
    covariance: Array
    by_common: Array
    """Derivatives of the estimates by what all points share, (m, k)"""
    tables: Mapping[str, Table]
    arrays: Mapping[str, Array]
    notes: tuple[str, ...]
    details: Mapping[str, Mapping[str, Any]]

    def added_to(self, result: Result, common: Array) -> Result:
        """Return a result with the features; `common` (k, m): covariance of what points share with its estimates."""
        cross = self.by_common @ common
        return replace(
            result,
            estimates=(*result.estimates, *self.estimates),
            covariance=np.block([[result.covariance, cross.T], [cross, self.covariance]]),
            statistics={**result.statistics, "features": len(self.tables[FEATURES])},
            tables={**result.tables, **self.tables},
            arrays={**result.arrays, **self.arrays},
            shown=(*result.shown, ShownTable(FEATURES, SHOWN)),
            notes=(*result.notes, *self.notes),
            details={**result.details, **self.details},
        )


def as_measured(points: Table | Result, noise: float | str) -> FeaturePoints:
    """Return the points of a list with their covariances; `noise` is that of coordinates without one."""
    table, spread = listed_points(points)
    nothing = np.zeros((len(table), 3, 1))
    return FeaturePoints(table, table.stacked("xyz"), spread.own(noise), nothing, np.zeros((1, 1)))


def fitted_features(wanted: Sequence[RequestedFeature], points: FeaturePoints) -> FittedFeatures:
    """Return features with their uncertainty; raises UndeterminedError or NotConvergedError with the feature's name.

    Points without a standard deviation have that of the distances from the least-squares feature: form counts as noise.
    """
    own, notes, dofs = points.own.copy(), [], {}
    for feature in wanted:
        unknown = feature.rows[~np.isfinite(own[feature.rows]).all(axis=(1, 2))]
        if unknown.size:
            noise, dof = _noise_of(feature, points.places[feature.rows])
            own[unknown] = np.eye(3) * noise**2
            dofs[feature.name] = float(dof)
            text = f"noise of a coordinate {sized(noise, 'length')}, by {dof} degrees of freedom; form counts as noise"
            notes.append(f"feature '{feature.name}': {text if noise else _NO_NOISE}")
    rows = np.arange(len(own))
    joint = JointCovariance(points.common, points.core, rows, np.nan_to_num(own), np.zeros(len(own)))
    corrected = Table.of({"point": points.table.texts("point"), "x y z [mm]": points.places})
    tables, arrays, by_common = fitted(wanted, corrected, joint)
    estimates, kept = estimates_of(tables)
    covariance = arrays[COVARIANCE][np.ix_(kept, kept)]
    of = {
        estimate.name: feature for feature in dofs for estimate in estimates if estimate.name.startswith(f"{feature}.")
    }
    details = {name: {"dof": dofs[feature]} for name, feature in of.items()}
    notes += exchanging(tables)
    return FittedFeatures(estimates, covariance, by_common[kept], tables, arrays, tuple(notes), details)


def _noise_of(feature: RequestedFeature, points: Array) -> tuple[float, int]:
    """Return the standard deviation of a coordinate by the distances from the least-squares feature, and its dof.

    It is 0 where the distances are rounding.
    """
    try:
        fit = least_squares(feature.shape, points)
    except (UndeterminedError, NotConvergedError) as error:
        raise type(error)(f"feature '{feature.name}': {error}") from error
    values = np.real(fit.ideal.deviations(points))
    # a line has a vector without a component along it, a circle the distance from it and from its plane
    each = 2 if feature.shape in (IdealFeature.LINE, IdealFeature.CIRCLE) else 1
    dof = each * len(points) - len(UNKNOWNS[feature.shape])
    if dof <= 0:
        raise UndeterminedError(
            f"feature '{feature.name}': {len(points)} points do not show their noise; give a column sigma_mm, `noise`, "
            "or more points"
        )
    noise = float(np.sqrt((values**2).sum() / dof))
    return noise if noise > rounding_of(points) else 0.0, dof


def features_alone(wanted: Sequence[RequestedFeature], points: Table | Result, noise: float | str) -> Result:
    """Return the result of a job that lays features through its points as they were measured."""
    empty = Result(KIND.name, "", (), np.zeros((0, 0)), {"points": len(table_of(points))})
    return fitted_features(wanted, as_measured(points, noise)).added_to(empty, np.zeros((1, 0)))
