"""The machine error between the sites: trilinear, and a smooth form with its own uncertainty.

The smooth form is a polynomial in x, y, z. Its total degree is the one with the smallest error at sites left out of the
fit (PRESS). The part of that error beyond the noise of the sites is the misfit. The uncertainty of the smooth form
combines the misfit and the uncertainty of the measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from metrocli import units
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError, UsageError
from metrocli.frozen import dataclass
from metrocli.instruments.ball_grid import numbers_at
from metrocli.result import Estimate, Result
from metrocli.table import Table

_DEGREES = 6
_AT_ONCE = 200
_TRIED = 20
"""Number of sites at which the noise of the left-out errors is calculated"""
Covariance = Callable[[Array], Array]
"""Function from weights (rows, sites) to the covariance (3, rows, rows) of the weighted errors, per component"""


@dataclass(frozen=True)
class SiteErrors:
    """The machine error at sites."""

    sites: Index
    """Index of each site, (sites, 3), in pitches"""
    pitch: float
    values: Array
    """(sites, 3) [mm]"""
    std: Array
    """(sites, 3), inf where the views leave it undetermined"""

    @property
    def places(self) -> Array:
        """Where the sites are, (sites, 3) [mm]."""
        return np.asarray(self.sites * self.pitch, dtype=float)

    @property
    def open(self) -> Mask:
        """Whether a component is undetermined, (sites, 3)."""
        return np.asarray(~np.isfinite(self.std))


@dataclass(frozen=True)
class Smooth:
    """The machine error as a polynomial, in coordinates scaled to -1 ... 1 over the grid."""

    degree: int
    centre: Array
    half: Array
    """(3,) [mm]"""
    coefficients: Array
    """(terms, 3) [mm]"""
    covariance: Array
    """(3, terms, terms)"""
    misfit: Array
    """Root mean square error at sites left out of the fit, without the part that is noise, (3,) [mm]"""

    def at(self, points: Array) -> tuple[Array, Array]:
        """Return the error (n, 3) at points [mm], and its standard uncertainty (n, 3), which includes the misfit."""
        design = _terms((points - self.centre) / self.half, self.degree)
        own = np.einsum("nt,ctu,nu->nc", design, self.covariance, design)
        return design @ self.coefficients, np.sqrt(np.maximum(own, 0.0) + self.misfit**2)


def _terms(scaled: Array, degree: int) -> Array:
    """Return products of Legendre polynomials of total degree up to `degree`, (n, terms)."""
    each = [np.polynomial.legendre.legvander(scaled[:, a], degree) for a in range(3)]
    exponents = [powers for powers in product(range(degree + 1), repeat=3) if sum(powers) <= degree]
    return np.stack([each[0][:, p] * each[1][:, q] * each[2][:, r] for p, q, r in exponents], axis=1)


def smooth(field: SiteErrors, covariance: Covariance) -> Smooth | None:
    """Return the smooth form of a field, or None if the sites lie in a plane or are too few for a polynomial."""
    places, errors = field.places, field.values
    centre = (places.max(axis=0) + places.min(axis=0)) / 2
    half = (places.max(axis=0) - places.min(axis=0)) / 2
    if (half <= 0).any():
        return None
    scaled = (places - centre) / half
    best: tuple[int, Array, Array] | None = None
    # the degree stays below the number of sites on a line: a polynomial through all of them has no error at the
    # sites, however large its error is between them
    layers = min(len(np.unique(places[:, a])) for a in range(3))
    for degree in range(1, min(_DEGREES, max(layers - 2, 1)) + 1):
        design = _terms(scaled, degree)
        if design.shape[1] > len(places) / 2 or np.linalg.matrix_rank(design) < design.shape[1]:
            break
        inverse: Array = np.asarray(np.linalg.pinv(design), dtype=float)
        left = (errors - design @ (inverse @ errors)) / (1 - np.einsum("nt,tn->n", design, inverse))[:, None]
        press: Array = (left**2).mean(axis=0)
        if best is None or float(press.sum()) < float(best[2].sum()):
            best = (degree, inverse, press)
    if best is None:
        return None
    degree, inverse, press = best
    some = np.unique(np.rint(np.linspace(0, len(places) - 1, _TRIED)).astype(np.intp))
    both = covariance(np.concatenate([inverse, _left_out(_terms(scaled, degree), inverse, some)]))
    terms = len(inverse)
    noise = np.einsum("cnn->cn", both)[:, terms:].mean(axis=1)
    beyond = np.sqrt(np.maximum(press - noise, 0.0))
    return Smooth(degree, centre, half, inverse @ errors, both[:, :terms, :terms], beyond)


def _left_out(design: Array, inverse: Array, sites: Index) -> Array:
    """Return the weights of all sites in the error at each of some sites left out of the fit, (sites, all).

    With the hat matrix H, row n is `(e_n - H_n) / (1 - H_nn)`.
    """
    hat = design[sites] @ inverse
    own = np.zeros_like(hat)
    own[np.arange(len(sites)), sites] = 1.0
    return np.asarray((own - hat) / (1 - hat[np.arange(len(sites)), sites])[:, None])


def trilinear(sites: Index, pitch: float, points: Array) -> tuple[Index, Array]:
    """Return the eight sites around each point and their weights, (n, 8) each; sites are -1 for points outside."""
    scaled = points / pitch
    low, high = sites.min(axis=0), sites.max(axis=0)
    # a point on the upper border belongs to the last cell
    corner = np.clip(np.floor(scaled), low, np.maximum(high - 1, low)).astype(np.intp)
    share = scaled - corner
    steps = np.array(list(product((0, 1), repeat=3)))
    weights = np.where(steps[None] == 1, share[:, None], 1 - share[:, None]).prod(axis=2)
    at = numbers_at(sites, corner[:, None] + steps)
    # a site that only rounding would give a weight may be missing
    weights[np.abs(weights) < 1e-12] = 0.0
    lost = ((at < 0) & (weights != 0)).any(axis=1) | (weights < 0).any(axis=1)
    return np.where(lost[:, None], -1, np.maximum(at, 0)), weights


def error_map(points: Table, field: SiteErrors, covariance: Covariance, form: Smooth | None) -> Table:
    """Return the machine error at points, trilinear and by the smooth form.

    The uncertainty of the trilinear value has two parts: the measurement, and the bend of the field between sites.
    The bend is at most 1/8 of the second differences, from which their noise is removed. It is the half-width of a
    rectangular distribution. The uncertainty is inf where a site is undetermined.
    Raises InputError if a point is not between measured sites.
    """
    sites, pitch = field.sites, field.pitch
    places = points.stacked("xyz")
    at, weights = trilinear(sites, pitch, places)
    lost = np.flatnonzero(at[:, 0] < 0)
    if lost.size:
        low, high = sites.min(axis=0) * pitch, sites.max(axis=0) * pitch
        box = ", ".join(f"{'xyz'[a]} {low[a]:g} ... {high[a]:g} mm" for a in range(3))
        names, text = points.texts("point"), "is not between measured sites"
        raise InputError([points.fault_at(row, f"point '{names[row]}' {text}", box) for row in lost[:20].tolist()])
    value, std = _trilinear_errors((at, weights), field, covariance)
    bend = _bend(field)[np.maximum(at, 0)].max(axis=1) / np.sqrt(3)
    # at a site itself nothing is interpolated
    inner = (np.abs(weights).max(axis=1) < 1 - 1e-9)[:, None]
    total = np.sqrt(std**2 + np.where(inner, bend, 0.0) ** 2)
    columns = {"point": points.texts("point"), "x y z [mm]": places}
    columns |= {"ex ey ez [mm]": value, "s_ex s_ey s_ez [mm]": total}
    if form is not None:
        smoothed, spread = form.at(places)
        columns |= {"smooth_ex smooth_ey smooth_ez [mm]": smoothed, "s_smooth_ex s_smooth_ey s_smooth_ez [mm]": spread}
    return Table.of(columns)


def _trilinear_errors(corners: tuple[Index, Array], field: SiteErrors, covariance: Covariance) -> tuple[Array, Array]:
    """Return the weighted errors (n, 3) and their standard uncertainties (n, 3), calculated in portions of points."""
    at, weights = corners
    std = np.empty((len(at), 3))
    for start in range(0, len(at), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        spread = np.zeros((len(at[part]), len(field.sites)))
        np.add.at(spread, (np.arange(len(spread))[:, None], at[part]), weights[part])
        std[part] = np.sqrt(np.maximum(np.einsum("cnn->nc", covariance(spread)), 0.0))
    std[(field.open[at] & (weights != 0)[:, :, None]).any(axis=1)] = np.inf
    return np.einsum("nk,nka->na", weights, field.values[at]), std


def _bend(field: SiteErrors) -> Array:
    """Return 1/8 of the second differences at each site without their noise, summed over the directions, (sites, 3)."""
    sites, errors, variance = field.sites, field.values, np.where(field.open, 0.0, field.std) ** 2
    total = np.zeros_like(errors)
    for axis in np.eye(3, dtype=np.intp):
        before, after = numbers_at(sites, sites - axis), numbers_at(sites, sites + axis)
        both = (before >= 0) & (after >= 0)
        second = errors[after[both]] - 2 * errors[both] + errors[before[both]]
        # of a second difference 1, -2, 1 of independent errors
        noise = variance[after[both]] + 4 * variance[both] + variance[before[both]]
        total[both] += np.sqrt(np.maximum(second**2 - noise, 0.0)) / 8
    return total


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
    points = Table.of({"point": ["here"], "x y z": [point]})
    try:
        machine_error = error_map(points, field, lambda weights: _covariance(result, weights), _smooth(result))
    except InputError as error:
        raise UsageError(f"--at: the point is not between measured sites ({error.faults[0].hint})") from error
    names = [name for name in machine_error if name[0] == "e" or name.startswith("smooth")]
    return tuple(
        Estimate(name, float(machine_error.numbers(name)[0]), float(machine_error.numbers(f"s_{name}")[0]), "mm")
        for name in names
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
