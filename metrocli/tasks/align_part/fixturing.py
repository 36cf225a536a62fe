"""Corrections of the fixture: the zero point of the part, how far screws raise it, and where its points are."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix, rotation_from_euler, rotation_from_vector
from metrocli.table import Columns, Table, columns
from metrocli.uncertainty.predicted import COMMON, CORE, POINTS_COVARIANCE
from metrocli.units import SPREAD, format_quantity

SUPPORTS = Columns(
    columns("support [text]", "x y z? [length]"),
    key=("support",),
    description="supports of the part, in the machine, that raise it along z",
)
FEWEST = 3
STEEPEST = np.radians(10.0)
"""Tilt of the part up to which screws level it"""
_ON_A_LINE = 1e-3
"""Extent of the supports across their line, relative to that along it, up to which they cannot level a part"""
_LEVEL = 1e-9
"""Tilt [rad] that no screw can take away; rounding leaves less"""
_BEYOND, _DIRECTIONS = 0.05, 90
"""Share of measurements that leave a larger tilt, and directions over which the tilt is averaged"""
_STEPS = np.array([1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6])
"""Steps of a difference [mm, rad]"""
_ORDER = (("shift x", 0), ("shift y", 1), ("shift z", 2), ("turn about z", 5), ("turn about y", 4), ("turn about x", 3))
"""Moves of the zero point in the order in which a machine makes them, `R = Rz(gamma) Ry(beta) Rx(alpha)`"""
_FARTHEST = 1e6
"""Standard deviations that fewer exceed, even where they have less than one degree of freedom"""


@dataclass(frozen=True)
class Corrections:
    """What the operator sets or turns."""

    tables: dict[str, Table]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def corrections(values: Array, covariance: Array, supports: Table | None, dof: float = math.inf) -> Corrections:
    """Return the moves of the zero point, and with supports how far to raise each and the zero point afterwards.

    `values` (6,) and `covariance` (6, 6) are those of x, y, z, alpha, beta, gamma, `dof` the degrees of freedom of the
    covariance; the supports pass `must_level`.
    """
    std = np.sqrt(np.diag(covariance))
    if supports is None:
        return Corrections({"zero_point": _zero_point(values, std)}, tuple(_zero_in_words(values, std)))
    tilt = float(np.arccos(min(abs(rotation_from_euler(*values[3:6])[2, 2]), 1.0)))
    if tilt > STEEPEST:
        steep = (
            f"the part's z axis is {np.degrees(tilt):.0f} deg off that of the machine: screws level a tilt of up to "
            f"{np.degrees(STEEPEST):.0f} deg, so the supports are not used",
        )
        return Corrections({"zero_point": _zero_point(values, std)}, tuple(_zero_in_words(values, std)), steep)
    table = _screws(values, covariance, supports)
    stays = supports.texts("support").index(table.texts("support")[-1])
    after, spread = _propagated(levelling(values, supports, stays), values, covariance)
    level = after, np.sqrt(np.diag(spread))
    tables = {"zero_point": _zero_point(values, std, level), "supports": table}
    words = _in_words(table, level, tilt_not_exceeded(spread[3:5, 3:5], dof))
    return Corrections(tables, (*_zero_in_words(values, std), *words))


def tilt_not_exceeded(covariance: Array, dof: float = math.inf) -> float:
    """Return the tilt [rad] that errors of alpha and beta with this covariance (2, 2) exceed in 5 % of measurements.

    A tilt is the length of a vector, so no multiple of a standard uncertainty covers it. Along the direction
    phi of the ellipse of errors it has a Rayleigh distribution of parameter g, `P(tilt > t) = mean exp(-t^2/(2 g^2))`.
    With a covariance of nu degrees of freedom it is `mean (1 + t^2/(nu g^2))^(-nu/2)`, the t distribution of two
    variables.
    """
    across, along = np.linalg.eigvalsh(covariance).clip(0.0)
    if along == 0:
        return 0.0
    phi = (np.arange(_DIRECTIONS) + 0.5) * (np.pi / 2 / _DIRECTIONS)
    squares = np.cos(phi) ** 2 + across / along * np.sin(phi) ** 2

    def beyond(t: float) -> float:
        power = -(t**2) / (2 * squares) if math.isinf(dof) else -dof / 2 * np.log1p(t**2 / (dof * squares))
        return float(np.exp(power).mean()) - _BEYOND

    # at 1 standard deviation of the larger one more than 5 % are beyond
    low, high = 1.0, _FARTHEST
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if beyond(middle) > 0 else (low, middle)
    return float(high * np.sqrt(along))


def _propagated(function: Callable[[Array], Array], values: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the values of a function of the pose, and their covariance."""
    by = np.stack(
        [(function(values + h) - function(values - h)) / (2 * h.sum()) for h in np.diag(_STEPS)],
        axis=1,
    )
    return function(values), np.asarray(by @ covariance @ by.T)


def _zero_point(values: Array, std: Array, level: tuple[Array, Array] | None = None) -> Table:
    """Return the table `zero_point`; `level` are the values after the screws, with their uncertainties."""
    rows = [number for _, number in _ORDER]
    table = Table.of({"move": [name for name, _ in _ORDER], "value": values[rows], "std": std[rows]})
    if level is not None:
        table = table.joined({"levelled": level[0][rows], "levelled_std": level[1][rows]})
    return table.joined({"unit": ["mm"] * 3 + ["rad"] * 3})


def must_level(supports: Table) -> None:
    """Raise InputError if supports cannot turn a part about x and y: fewer than three, or all on one line."""
    places = supports.stacked(("x", "y"))
    if len(places) < FEWEST:
        hint = "list the screws below the part, e.g. one at each corner"
        raise InputError(
            [supports.fault(f"number of supports: {len(places)}; a part is levelled by {FEWEST} or more", hint)]
        )
    sizes = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if sizes[1] < _ON_A_LINE * sizes[0]:
        raise InputError([supports.fault("all supports lie on one line", "add one beside it")])


def raises(angles: Array, places: Array) -> Array:
    """Return how far each support (n, 2) is raised so that the part is level in the machine (n,).

    The least is 0. With k = R e_z the part's plane falls by (kx, ky)/kz; what is raised by as much is level.
    """
    k = rotation_from_euler(*angles)[:, 2]
    heights = places @ (k[:2] / k[2])
    return np.asarray(heights - heights.min())


def levelling(values: Array, supports: Table, stays: int) -> Callable[[Array], Array]:
    """Return the function from a pose (6,) before the screws are turned to that afterwards.

    The screws are set by `values`. The part turns about its contact with the support that stays, by the smallest
    rotation that makes `values` level, and does not slip. Without the column z the contact is on its plane z = 0.
    """
    k, shift = rotation_from_euler(*values[3:6])[:, 2], values[:3]
    at = supports.stacked(("x", "y"))[stays]
    height = float(supports.numbers("z")[stays]) if "z" in supports else float("nan")
    if np.isnan(height):
        height = float(shift[2] - (at - shift[:2]) @ k[:2] / k[2])
    contact = np.append(at, height)
    axis = np.cross(k, [0.0, 0.0, np.sign(k[2])])
    size = float(np.linalg.norm(axis))
    by = rotation_from_vector(axis * (np.arctan2(size, abs(k[2])) / size if size > 0 else 1.0))

    def after(pose: Array) -> Array:
        turned = by @ rotation_from_euler(*pose[3:6])
        return poses.euler_form(poses.pose(turned, by @ (pose[:3] - contact) + contact))

    return after


def _screws(values: Array, covariance: Array, supports: Table) -> Table:
    """Return the table `supports`: what to raise, by how much, in the order to turn the screws, the largest first.

    `tilt_left` is the slope of the plane of least squares through all supports after this screw and those before it. It
    need not fall with each screw: where two neighbours rise alike, the first alone tilts the part between them.
    """
    places = supports.stacked(("x", "y"))
    size = raises(values[3:6], places)
    lowest = int(size.argmin())

    def relative(at: Array) -> Array:
        raised = raises(at[3:6], places)
        return np.asarray(raised - raised[lowest])

    std = np.sqrt(np.diag(_propagated(relative, values, covariance)[1]))
    order = np.argsort(-size, kind="stable")
    # column j: what is left to raise after the screws up to j
    left = np.tril(size[order][:, None] * np.ones(len(size)), -1)
    slopes = np.linalg.lstsq(np.column_stack([places[order], np.ones(len(size))]), left, rcond=None)[0][:2]
    return Table.of(
        {
            "support [text]": np.array(supports.texts("support"), dtype=str)[order],
            "x y [mm]": places[order],
            "raise [mm]": size[order],
            "raise_std [mm]": std[order],
            "tilt_left [rad]": np.hypot(*slopes),
        }
    )


def _zero_in_words(values: Array, std: Array) -> Iterator[str]:
    yield f"zero point of the part in the machine, {SPREAD}: {_moves(values, std, _ORDER)}"


def _moves(values: Array, std: Array, moves: tuple[tuple[str, int], ...]) -> str:
    units = ("mm",) * 3 + ("rad",) * 3
    return ", ".join(f"{name} {format_quantity(float(values[k]), units[k], float(std[k]))}" for name, k in moves)


def _in_words(table: Table, level: tuple[Array, Array], tilt_left: float) -> Iterator[str]:
    """Yield what the operator does, and what is left for the zero point of the machine."""
    steps = zip(*(table.columns[name] for name in ("support", "raise", "raise_std", "tilt_left")), strict=True)
    yield f"to level the part, raise the supports in this order, {SPREAD}:"
    for name, size, std, left in steps:
        if size > 0:
            tilt = "" if left < _LEVEL else f" (tilt left {1e3 * left:.3f} mm/m)"
            yield f"    {name}: {format_quantity(float(size), 'mm', float(std))}{tilt}"
        else:
            yield f"    {name}: stays"
    yield f"then, if the part does not slip, its zero point is, {SPREAD}: {_moves(*level, _ORDER[:4])}"
    yield (
        f"tilt that may be left: {1e3 * tilt_left:.2g} mm/m (95 % of measurements leave less); "
        "measure again if it matters that nothing slips"
    )


def predicted_points(
    points: Table, pose: Array, covariance: Array, growth: float = 0.0
) -> tuple[Table, dict[str, Array]]:
    """Return the table `points` in the machine, and the arrays of its covariance.

    `X_machine = R (1 + g) X + d`, with `dX_machine = u + w x R X + R X dg` for a step (u, w) of the pose (6,).
    `covariance` (6 + k, 6 + k) is of x, y, z, alpha, beta, gamma and k unknowns that g sums up; to it a point adds its
    own sigma, if it has one.
    """
    listed = points.stacked(("x", "y", "z"))
    places = listed * (1 + growth)
    turn = poses.rotation_of(pose)
    by_step = np.concatenate([np.tile(np.eye(3), (len(places), 1, 1)), -cross_matrix(places @ turn.T)], axis=2)
    by_growth = np.repeat((listed @ turn.T)[:, :, None], len(covariance) - 6, axis=2)
    common = np.concatenate([by_step @ np.linalg.inv(poses.euler_form_by_step(pose)), by_growth], axis=2)
    own = (points.numbers("sigma", 0.0) ** 2)[:, None, None] * np.eye(3)
    whole = common @ covariance @ np.swapaxes(common, 1, 2) + own
    std = np.sqrt(np.einsum("nkk->nk", whole))
    at = poses.apply(pose, places)
    table = Table.of({"point [text]": points.texts("point"), "x y z [mm]": at, "sx sy sz [mm]": std})
    return table, {POINTS_COVARIANCE: whole, COMMON: common, CORE: covariance}
