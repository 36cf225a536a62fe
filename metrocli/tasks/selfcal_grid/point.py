"""The machine error at one point, from the result of a self-calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Array
from metrocli.errors import InputError, UsageError
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.error_map import SiteErrors, Smooth, error_map


def error_at(result: Result, place: Sequence[str]) -> tuple[Estimate, ...]:
    """Return the machine error at x, y, z, trilinear and by the smooth form, with standard uncertainties.

    If the result holds no covariance of the sites, the sites count as fully correlated, which gives the largest
    uncertainty that is possible. Raises UsageError if the result has no machine error, a coordinate is not a length, or
    the point is not between measured sites.
    """
    if "machine_error" not in result.tables:
        raise UsageError(f"the result of {result.kind} has no machine error")
    try:
        point = [units.parse_quantity(text, "length") for text in place]
    except units.QuantityError as error:
        raise UsageError(f"--at: {error.message}; {error.hint}") from error
    table = result.tables["machine_error"]
    sites = np.asarray(np.rint(table.stacked("ijk")), dtype=np.intp)
    values, std = (table.stacked([f"{s}e{axis}" for axis in "xyz"]) for s in ("", "s_"))
    field = SiteErrors(sites, float(result.arrays["pitch"][0]), values, std)
    points = Table({"point": np.array(["here"])} | {axis: np.array([point[n]]) for n, axis in enumerate("xyz")})
    try:
        found = error_map(points, field, lambda weights: _covariance(result, weights), _smooth(result))
    except InputError as error:
        raise UsageError(f"--at: the point is not between measured sites ({error.faults[0].hint})") from error
    names = [name for name in found if name[0] == "e" or name.startswith("smooth")]
    return tuple(
        Estimate(name, float(found.numbers(name)[0]), float(found.numbers(f"s_{name}")[0]), "mm") for name in names
    )


def _covariance(result: Result, weights: Array) -> Array:
    whole = result.arrays.get("machine_error_covariance")
    if whole is None:
        std = result.tables["machine_error"].stacked(["s_ex", "s_ey", "s_ez"])
        bound = np.abs(weights) @ np.where(np.isfinite(std), std, 0.0)
        return np.asarray(np.einsum("nc,mc->cnm", bound, bound))
    sites = weights.shape[1]
    parts = whole.reshape(sites, 3, sites, 3)
    return np.stack([weights @ parts[:, c, :, c] @ weights.T for c in range(3)])


def _smooth(result: Result) -> Smooth | None:
    arrays = {name.partition("/")[2]: values for name, values in result.arrays.items() if name.startswith("smooth/")}
    if not arrays:
        return None
    kept = ("centre", "half", "coefficients", "covariance", "misfit")
    return Smooth(round(float(arrays["degree"][0])), *(arrays[name] for name in kept))
