"""Repeated sets: how far the results of one measurement, made several times, scatter, against what each states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.uncertainty.comparison import POINTS
from metrocli.uncertainty.predicted import PredictedPlaces, after_fit, has_points, in_machine, independent, points_of

FEWEST = 3
LENGTHS = "length_errors"


@dataclass(frozen=True)
class RepeatedQuantity:
    """One quantity over several sets."""

    group: str
    """`estimates`, `points` for a coordinate of all points together, or `length_errors`"""
    name: str
    mean: float
    """nan for points"""
    sigma: float
    """Standard deviation over the sets"""
    std: float
    """Standard uncertainty as stated, root mean square over the sets"""
    unit: str

    @property
    def ratio(self) -> float:
        """`sigma / std`; near 1 if the stated uncertainty is that of a repeated set."""
        if self.std > 0:
            return self.sigma / self.std
        return float("inf") if self.sigma > 0 else 0.0


@dataclass(frozen=True)
class Repetition:
    """All quantities that several sets have in common."""

    sets: int
    quantities: tuple[RepeatedQuantity, ...]

    @property
    def max_ratio(self) -> float:
        """Largest ratio of scatter and stated uncertainty."""
        return max(quantity.ratio for quantity in self.quantities)


def repetition(results: Sequence[Result]) -> Repetition:
    """Return the scatter of three or more results of one kind.

    `sigma^2 = sum (x_k - mean)^2 / (sets - 1)`. Points in a frame of their own are laid onto those of the first set by
    shift and turn; those in a machine are taken as they are. Raises InputError for two kinds, or nothing in common.
    """
    kinds = sorted({result.kind for result in results})
    if len(kinds) > 1:
        raise InputError(f"results of different kinds are not repeated sets: {', '.join(kinds)}")
    quantities = (*_estimates(results), *_lengths(results), *_points(results))
    if not quantities:
        raise InputError("the results have nothing in common: no estimate, test length or point of the same name")
    return Repetition(len(results), quantities)


def _quantity(group: str, name: str, values: Array, std: Array, unit: str) -> RepeatedQuantity:
    root_mean_square = float(np.sqrt((std**2).mean()))
    return RepeatedQuantity(group, name, float(values.mean()), float(values.std(ddof=1)), root_mean_square, unit)


def _estimates(results: Sequence[Result]) -> Iterator[RepeatedQuantity]:
    every = [{estimate.name: estimate for estimate in result.estimates} for result in results]
    for name, first in every[0].items():
        if all(name in estimates for estimates in every):
            values, std = (
                np.array([getattr(estimates[name], what) for estimates in every]) for what in ("value", "std")
            )
            yield _quantity("estimates", name, values, std, first.unit)


def _lengths(results: Sequence[Result]) -> Iterator[RepeatedQuantity]:
    """Yield the measured lengths between the ends of test lengths."""
    if not all(LENGTHS in result.tables for result in results):
        return
    tables = [result.tables[LENGTHS] for result in results]
    every = [
        {
            f"{a} - {b}": (size, std)
            for a, b, size, std in zip(
                *(table.columns[name] for name in ("from", "to", "measured", "std")), strict=True
            )
        }
        for table in tables
    ]
    for name in every[0]:
        if all(name in lengths for lengths in every):
            values, std = np.array([lengths[name] for lengths in every], dtype=float).T
            yield _quantity(LENGTHS, name, values, std, "mm")


def _points(results: Sequence[Result]) -> Iterator[RepeatedQuantity]:
    """Yield each coordinate, pooled over the points that all sets have."""
    tables = [result.tables.get(POINTS) for result in results]
    if any(table is None or not {"point", "x", "y", "z", "sx"} <= set(table) for table in tables):
        return
    rows = [{name: row for row, name in enumerate(table.texts("point"))} for table in tables if table is not None]
    common = [name for name in rows[0] if all(name in known for known in rows)]
    if len(common) < FEWEST:
        return
    every = [
        _places(result).of(np.array([known[name] for name in common]))
        for result, known in zip(results, rows, strict=True)
    ]
    at, covariance = np.array([places.values for places in every]), [places.covariance for places in every]
    if not in_machine(results[0]):
        at = np.array([poses.apply(poses.fit_pose(values, at[0]), values) for values in at])
        # the fit takes from the scatter what the points have in common, such as the uncertainty of a given datum
        covariance = [after_fit(places, places.own) for places in every]
    sigma = np.sqrt((at.std(axis=0, ddof=1) ** 2).mean(axis=0))
    std = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3).mean(axis=(0, 1)))
    for k, axis in enumerate("xyz"):
        name = f"{axis} of {len(common)} points"
        yield RepeatedQuantity(POINTS, name, float("nan"), float(sigma[k]), float(std[k]), "mm")


def _places(result: Result) -> PredictedPlaces:
    """Return the points of a result; without their covariance each has its standard uncertainties alone."""
    if has_points(result):
        return points_of(result)
    table = result.tables[POINTS]
    variances = table.stacked(("sx", "sy", "sz")) ** 2
    return independent(table.stacked("xyz"), variances[:, :, None] * np.eye(3))
