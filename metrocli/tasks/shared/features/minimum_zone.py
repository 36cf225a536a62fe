"""Ideal features of the minimum zone, with the points in contact. Method: docs/algorithms/feature-fits.md."""

from __future__ import annotations

import itertools

import numpy as np

from metrocli.adjust.small_programmes import highest, quadratic
from metrocli.arrays import Array
from metrocli.errors import NotConvergedError
from metrocli.tasks.shared.features.fit import Criterion, FeatureFit, ZoneContact, distances, gradients, least_squares
from metrocli.tasks.shared.features.ideal import STEP, ZONE_UNKNOWNS, Ideal, IdealFeature

_ITERATIONS = 200
_EXACT = 1e-12
"""Step, relative to the size of the feature, at which an iteration ends, and a form that is rounding"""
_GAINS = (1e-2, 1e-4, 1e-6, 1e-9, 1e-12)
"""Relative gains of the next programme at which Newton's method takes over, tried one after the other"""
_LEAST_WEIGHTS = (1e-9, 1e-5, 1e-2)
"""Least weights of a point in contact, tried one after the other"""
_SMALLEST_RADIUS = 1e-7
"""Radius of a linear programme, relative to the zone, at which no more is gained"""
_PROXIMAL = 0.1
"""Curvature by the level in a quadratic programme"""
_PROVEN = 1e4
"""Multiple of rounding that a proof may be off by"""
_OVERSHOOT, _ROUNDING = 0.3, 1e-9
"""Relative growth of the zone up to which a step of Newton's method is taken, and that of its end"""
_STEPS, _STEPS_OF_SETS = 20, 60
"""Steps of Newton's method, and those for a set of points that may be in contact"""
_FEW = 6
"""Farthest points whose sets are all tried where no other way has a proof"""
_NEAR = 1e-2
"""Points within this share of the zone from its limits may be in contact"""
_SECOND = 1e-5
"""Step of a second derivative, relative to the size of the feature"""


def minimum_zone(shape: IdealFeature, points: Array) -> FeatureFit:
    """Return the feature whose largest deviation is least (ISO 1101: minimum zone), near that of least squares.

    Programmes approach it; Newton's method on the points in contact ends it. Raises as `least_squares` does.
    """
    start = least_squares(shape, points)
    wanted = list(ZONE_UNKNOWNS[shape])
    level = _level(start.ideal, points)
    if level <= _EXACT * start.ideal.size:
        return FeatureFit(start.ideal, Criterion.MINIMUM_ZONE, start.deviations, start.sensitivity)
    zone = _approached(start.ideal, points, wanted) or _enumerated(start.ideal, points, wanted)
    if zone is None:
        raise NotConvergedError(f"no points in contact prove the minimum zone of the {shape}")
    ideal, contact = zone[0].about(points.mean(axis=0)), zone[1]
    sensitivity = _of_contact(ideal, points, wanted, contact, start)
    return FeatureFit(ideal, Criterion.MINIMUM_ZONE, distances(ideal, points), sensitivity, contact)


def _approached(ideal: Ideal, points: Array, wanted: list[int]) -> tuple[Ideal, ZoneContact] | None:
    """Return the minimum zone by programmes and Newton's method, and its points in contact; None without a proof."""
    nearer = _by_quadratic if ideal.shape is IdealFeature.LINE else _by_linear
    # a few programmes first: Newton's method on the wrong points in contact does not come back
    for gain, least in itertools.product(_GAINS, _LEAST_WEIGHTS):
        ideal = nearer(ideal, points, wanted, gain) if least == _LEAST_WEIGHTS[0] else ideal
        held, contact = _in_contact(ideal, points, wanted, least)
        if _proven(held, points, contact):
            return held, contact
    return None


def _enumerated(ideal: Ideal, points: Array, wanted: list[int]) -> tuple[Ideal, ZoneContact] | None:
    """Return the least zone that a set of the farthest points proves, of all their sets; None without one.

    Where two points hold nearly all of the zone, others come into contact far from where programmes end.
    """
    values = distances(ideal, points)
    farthest = np.argsort(-np.abs(values))[:_FEW]
    best, least = None, np.inf
    # from two points to one more than there are unknowns: more cannot all be needed
    for size in range(2, len(wanted) + 2):
        for chosen in itertools.combinations(farthest, size):
            rows = np.array(chosen)
            contact = ZoneContact(rows, np.sign(values[rows]), np.full(size, 1 / size), np.inf)
            held = _newtons((ideal, contact), points, wanted, _STEPS_OF_SETS, ideal.size)
            level = _level(held[0], points)
            if level < least and _proven(held[0], points, held[1]):
                best, least = held, level
    return best


def _level(ideal: Ideal, points: Array) -> float:
    return float(np.abs(distances(ideal, points)).max())


def _proven(ideal: Ideal, points: Array, contact: ZoneContact) -> bool:
    """Return whether the points in contact hold the zone: none is beyond them, and no change makes all smaller."""
    at_limit = float(np.abs(distances(ideal, points[contact.rows])).min())
    inside = _level(ideal, points) <= at_limit + _PROVEN * ideal.size * _EXACT
    return inside and contact.optimality < _PROVEN * _EXACT and float(contact.weights.min()) > 0


def _by_linear(ideal: Ideal, points: Array, wanted: list[int], gain: float) -> Ideal:
    """Return a feature near its minimum zone, where a linear programme promises less than a relative gain.

    The programmes are solved within a radius, in units of the zone, that follows their success.
    """
    level, radius = _level(ideal, points), 1.0
    for _ in range(_ITERATIONS):
        values, rows = distances(ideal, points) / level, gradients(ideal, points)[0][:, wanted]
        # each point limits the zone on both sides
        values, rows = np.concatenate([values, -values]), np.concatenate([rows, -rows])
        optimum, least = highest(-rows, -values, radius)
        step = np.zeros(STEP)
        step[wanted] = level * optimum.x
        trial = ideal.moved(step)
        reached = _level(trial, points)
        promised = level * (1 + least)
        if reached < level:
            # a trust region: it grows where the programme kept more than half of what it promised
            radius *= 2 if level - reached > promised / 2 else 0.5
            ideal, level = trial, reached
        else:
            radius /= 4
        if promised <= gain * level or radius < _SMALLEST_RADIUS:
            break
    return ideal


def _by_quadratic(ideal: Ideal, points: Array, wanted: list[int], gain: float) -> Ideal:
    """Return a line near the axis of the smallest cylinder about the points, where a step gains less.

    `min max q_i` with q half the square of the distance, in units of the largest: sequential quadratic programmes with
    the Hessian `sum w_i A_i'A_i` of the last weights w. A small share of `s^2` makes the level s a bounded unknown.
    """
    size, weights = len(wanted), np.full(len(points), 1 / len(points))
    for _ in range(_ITERATIONS):
        level = _level(ideal, points)
        away, rows = np.real(ideal.deviations(points)) / level, ideal.by_step(points)[:, :, wanted]
        half = (away**2).sum(axis=1) / 2
        hessian = np.zeros((size + 1, size + 1))
        hessian[:size, :size] = np.einsum("n,nka,nkb->ab", weights, rows, rows)
        hessian[range(size + 1), range(size + 1)] += np.append(np.full(size, _EXACT * np.trace(hessian)), _PROXIMAL)
        against = np.column_stack([-np.einsum("nk,nka->na", away, rows), np.ones(len(points))])
        solved = quadratic(hessian, np.append(np.zeros(size), 1.0), against, half - half.max())
        if solved is None:
            break
        weights = solved.duals / solved.duals.sum()
        step = np.zeros(STEP)
        step[wanted] = level * solved.x[:size]
        trial = next((moved for k in range(30) if _level(moved := ideal.moved(step / 2**k), points) < level), None)
        if trial is None:
            return ideal
        ideal, before = trial, level
        if before - _level(ideal, points) <= gain * before:
            break
    return ideal


def _in_contact(ideal: Ideal, points: Array, wanted: list[int], least: float) -> tuple[Ideal, ZoneContact]:
    """Return the feature held by its points in contact, to rounding, and those points.

    A step may overshoot the zone a little on the way: the next one mends what the bend of the distances left.
    """
    begun, level = (ideal, _contact(ideal, points, wanted, least)), _level(ideal, points)
    held = _newtons(begun, points, wanted, _STEPS, level * (1 + _OVERSHOOT))
    return held if _level(held[0], points) <= level * (1 + _ROUNDING) else begun


def _newtons(
    held: tuple[Ideal, ZoneContact], points: Array, wanted: list[int], steps: int, limit: float
) -> tuple[Ideal, ZoneContact]:
    """Return a feature and its points in contact after steps of Newton's method, while the zone is below a limit."""
    for _ in range(steps):
        step, weights = _newton(held[0], points, wanted, held[1])
        trial = held[0].moved(step)
        if not np.isfinite(step).all() or _level(trial, points) > limit:
            break
        held = trial, _weighted(trial, points, wanted, held[1], weights)
        if np.abs(step).max() <= _EXACT * trial.size:
            break
    return held


def _contact(ideal: Ideal, points: Array, wanted: list[int], least: float) -> ZoneContact:
    """Return the points in contact with the best proof: `min |sum w_i g_i|` over w >= 0 of sum 1 (Lawson, Hanson).

    Points of less than the least weight are left out: near the solution they only make up for what is not exact yet.
    """
    from scipy.optimize import nnls

    values = distances(ideal, points)
    level = np.abs(values).max()
    near = np.flatnonzero(np.abs(values) >= (1 - _NEAR) * level)
    # a zone has few points in contact, and nnls takes long for many that are nearly so
    near = near[np.argsort(-np.abs(values[near]))[:200]]
    sides = np.sign(values[near])
    rows = sides[:, None] * gradients(ideal, points[near])[0][:, wanted]
    # a point that is farther from the limit than the others costs as much as it lacks
    lacking = (level - np.abs(values[near])) / level
    stacked = np.vstack([rows.T, lacking, np.ones(len(near))])
    weights, _ = nnls(stacked, np.append(np.zeros(len(wanted) + 1), 1.0), maxiter=1000)
    weights /= weights.sum()
    held = weights > least
    optimality = float(np.linalg.norm(weights @ rows))
    return ZoneContact(near[held], sides[held], weights[held], optimality)


def _weighted(ideal: Ideal, points: Array, wanted: list[int], contact: ZoneContact, weights: Array) -> ZoneContact:
    rows = contact.sides[:, None] * gradients(ideal, points[contact.rows])[0][:, wanted]
    return ZoneContact(contact.rows, contact.sides, weights, float(np.linalg.norm(weights @ rows)))


def _newton(ideal: Ideal, points: Array, wanted: list[int], contact: ZoneContact) -> tuple[Array, Array]:
    """Return the step (7,) and the weights of `sum w_i g_i = 0`, `sum w_i = 1`, `f_i = t` from a linearisation."""
    at, sides = points[contact.rows], contact.sides
    values = sides * distances(ideal, at)
    rows = sides[:, None] * gradients(ideal, at)[0][:, wanted]
    size, held = len(wanted), len(values)
    matrix = _bordered(_curvature(ideal, at, wanted, sides * contact.weights), rows)
    wanted_values = np.concatenate([np.zeros(size), [1.0], -values])
    # lstsq: the matrix is singular where the curvature does not hold what few points in contact leave open
    solved = np.linalg.lstsq(matrix, wanted_values, rcond=1e-14)[0]
    step = np.zeros(STEP)
    step[wanted] = solved[:size]
    return step, solved[size + 1 : size + 1 + held]


def _bordered(curvature: Array, rows: Array) -> Array:
    """Return `[[H, 0, G'], [0, 0, 1'], [G, -1, 0]]` for the unknowns step, level and weights."""
    held, size = rows.shape
    matrix = np.zeros((size + 1 + held, size + 1 + held))
    matrix[:size, :size], matrix[:size, size + 1 :] = curvature, rows.T
    matrix[size, size + 1 :] = 1.0
    matrix[size + 1 :, :size], matrix[size + 1 :, size] = rows, -1.0
    return matrix


def _curvature(ideal: Ideal, points: Array, wanted: list[int], weights: Array) -> Array:
    """Return the second derivative of the weighted sum of deviations by the step, from differences of gradients."""
    h = _SECOND * ideal.size
    columns = []
    for direction in np.eye(STEP)[wanted]:
        ahead, behind = (gradients(ideal, points, sign * h * direction)[0] for sign in (1, -1))
        columns.append(weights @ (ahead - behind)[:, wanted] / (2 * h))
    matrix = np.stack(columns, axis=1)
    return np.asarray((matrix + matrix.T) / 2)


def _of_contact(ideal: Ideal, points: Array, wanted: list[int], contact: ZoneContact, plain: FeatureFit) -> Array:
    """Return the derivative of the step by each point (7, n, 3) with the points in contact held.

    What a circle's zone leaves to its least-squares plane follows that plane.
    """
    at, sides, size = points[contact.rows], contact.sides, len(wanted)
    rows, by_point = gradients(ideal, at)
    matrix = _bordered(_curvature(ideal, at, wanted, sides * contact.weights), sides[:, None] * rows[:, wanted])
    inverse = np.linalg.pinv(matrix, rcond=1e-14)[:size]
    h = _SECOND * ideal.size
    sensitivity = plain.sensitivity.copy()
    sensitivity[wanted] = 0.0
    for c, direction in enumerate(np.eye(3)):
        ahead, behind = (gradients(ideal, at + sign * h * direction)[0][:, wanted] for sign in (1, -1))
        mixed = (sides * contact.weights)[:, None] * (ahead - behind) / (2 * h)
        change = mixed @ inverse[:, :size].T + (sides * by_point[:, c])[:, None] * inverse[:, size + 1 :].T
        sensitivity[np.array(wanted)[:, None], contact.rows, c] = -change.T
    return sensitivity
