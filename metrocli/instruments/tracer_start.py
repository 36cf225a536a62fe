"""Starting values of the places and dead paths of tracers, from lengths to points that are roughly known."""

from __future__ import annotations

from functools import lru_cache
from random import Random  # numpy.random takes longer to load than a small job to adjust

import numpy as np

from metrocli.adjust.medians import median
from metrocli.arrays import Array

_STEPS = 60
_FLAT = 1e-4
"""Points whose thickness is below this share of their extent are treated as coplanar"""
_AS_GOOD, _ROUNDING = 1.5, 1e-9
"""A place counts as equally good if its misfit is at most this multiple of the smallest, plus a rounding error"""
_DRAWS, _COMPARED, _ENOUGH = 60, 300, 8
"""Random samples of lengths, most lengths used to compare them, and fewest lengths of a tracer for sampling"""
_GROSS, _ROUNDS = 12.0, 30
"""Lengths with residuals above this multiple of the median are down-weighted; most rounds of reweighting"""
MOST = 2000
"""Most lengths of a tracer that its start is found from: more determine it no better than a start must be"""
_STILL = 1e-7
"""Relative change in a round of reweighting below which the rounds stop"""
_ARRIVED = 1e-10
"""Step, relative to the extent of the points, below which a descent stops: a start need be no better"""
_CREEPS = 1e-4
"""Relative decrease of the sum of squares in a step below which a descent stops"""


def start(points: Array, lengths: Array, absolute: bool = False, near: Array | None = None) -> Array:
    """Return (x0, y0, z0, dead path) of one tracer from lengths (n,) to points (n, 3); nan if they do not determine it.

    Squaring `l + l0 = |x - x0|` gives `|x|^2 - l^2 = 2 x.x0 + 2 l l0 - (|x0|^2 - l0^2)`, which is linear in five
    unknowns. Coplanar points leave two mirrored places. All of them, and the listed place `near`, are refined by
    Gauss-Newton steps. Of those that fit equally well, the one nearest to `near` is returned. If some lengths have
    gross errors, the sum of |v| is minimised, which is robust against them. Of many lengths a random sample is used.
    """
    if len(lengths) > MOST:
        some = Random(0).sample(range(len(lengths)), MOST)
        points, lengths = points[some], lengths[some]
    contents = (
        None if array is None else np.asarray(array, dtype=float).tobytes() for array in (points, lengths, near)
    )
    return np.array(_from_contents(*contents, absolute))


@lru_cache(maxsize=64)
def _from_contents(points: bytes, lengths: bytes, near: bytes | None, absolute: bool) -> Array:
    """Return what `start` returns, from the contents of its arrays.

    The last ones are kept: other settings of a job are tried on the same lengths many times.
    """
    places = np.frombuffer(points).reshape(-1, 3)
    centre = places.mean(axis=0)
    local = places - centre
    scale = float(np.abs(local).max()) or 1.0
    local, reading = local / scale, np.frombuffer(lengths) / scale
    guesses = _guesses(local, reading, absolute)
    listed_at = None if near is None else (np.frombuffer(near) - centre) / scale
    if listed_at is not None:
        dead = 0.0 if absolute else float(median(np.linalg.norm(local - listed_at, axis=1) - reading))
        guesses.append(np.array([*listed_at, dead]))
    candidates = [_refined(local, reading, guess, absolute) for guess in guesses]
    if not candidates:
        return np.full(4, np.nan)
    least = min(misfit for _, misfit in candidates)
    good = [state for state, misfit in candidates if misfit <= _AS_GOOD * least + _ROUNDING]
    best = good[0] if listed_at is None else min(good, key=lambda state: float(np.linalg.norm(state[:3] - listed_at)))
    return np.concatenate([best[:3] * scale + centre, best[3:] * scale])


def _guesses(local: Array, reading: Array, absolute: bool) -> list[Array]:
    _, spread, axes = np.linalg.svd(local, full_matrices=False)
    rank = int((spread > _FLAT * spread[0]).sum())
    plane = local @ axes[:rank].T
    columns = [2 * plane, *([] if absolute else [2 * reading[:, None]]), -np.ones((len(local), 1))]
    matrix = np.concatenate(columns, axis=1)
    if len(local) < matrix.shape[1]:
        return []
    solved = np.linalg.lstsq(matrix, (local**2).sum(axis=1) - reading**2, rcond=None)[0]
    inside, dead, constant = solved[:rank], 0.0 if absolute else float(solved[rank]), float(solved[-1])
    # `|x0|^2` is among the unknowns, so that the height above the plane follows from it, but not its sign
    across = np.sqrt(max(constant + dead**2 - float(inside @ inside), 0.0))
    guesses = []
    for sign in (1.0, -1.0) if rank < 3 else (0.0,):
        place = inside @ axes[:rank]
        if rank < 3:
            # at least a tenth of the extent: from the plane itself no derivative leads out of it
            place = place + sign * max(across, 0.1) * (axes[rank] if rank < len(axes) else np.array([0.0, 0.0, 1.0]))
        guesses.append(np.array([*place, dead]))
    if rank == 3 and len(local) >= _ENOUGH:
        guesses.append(_unspoiled(local, reading, absolute))
    return guesses


def _unspoiled(local: Array, reading: Array, absolute: bool) -> Array:
    """Return place and dead path from the sample of lengths with the smallest median residual of all lengths.

    Gross errors spoil the linear equations, since lengths are coefficients in them. Most small samples are free of
    gross errors (Rousseeuw 1984, least median of squares).
    """
    n = len(local)
    draw = Random(0)
    rows = np.array([draw.sample(range(n), 6) for _ in range(_DRAWS)])
    known, last = reading[rows][:, :, None], -np.ones((*rows.shape, 1))
    matrix = np.concatenate([2 * local[rows], *([] if absolute else [2 * known]), last], axis=2)
    right = (local[rows] ** 2).sum(axis=2) - reading[rows] ** 2
    states = (np.linalg.pinv(matrix) @ right[:, :, None])[:, :, 0]
    # of absolute lengths the fourth unknown is the constant, and the dead path is 0
    states[:, 3] *= not absolute
    some = np.linspace(0, n - 1, min(n, _COMPARED)).astype(int)
    miss = reading[some] + states[:, 3:4] - np.linalg.norm(local[some] - states[:, None, :3], axis=2)
    return np.asarray(states[np.argmin(median(np.abs(miss))), :4])


def _weights(residual: Array) -> Array:
    """Return the factors of the residuals that turn squares into |v|; all 1 if no residual is far off."""
    miss = np.abs(residual)
    middle = max(float(median(miss)), _ROUNDING)
    if miss.max() <= _GROSS * middle:
        return np.ones(len(miss))
    return np.asarray(np.sqrt(middle / np.maximum(miss, middle)))


def _refined(local: Array, reading: Array, guess: Array, absolute: bool) -> tuple[Array, float]:
    """Return the solution near a guess and its mean |residual|; gross errors get low weights."""
    state = guess
    for turn in range(_ROUNDS):
        before, weights = state, _weights(_residual(local, reading, state, absolute)[0])
        if turn and (weights == 1).all():
            break
        state = _descended(local, reading, state, absolute, weights)
        if np.abs(state - before).max() < _STILL:
            break
    miss = np.abs(_residual(local, reading, state, absolute)[0])
    # clipped, so that one gross error does not decide between two places
    return state, float(np.minimum(miss, _GROSS * median(miss) + _ROUNDING).mean())


def _descended(local: Array, reading: Array, guess: Array, absolute: bool, weights: Array) -> Array:
    """Return the least-squares solution near a guess by damped Gauss-Newton steps; weights (n,) multiply residuals."""
    state, damping = guess.copy(), 0.0
    residual, jacobian = _residual(local, reading, state, absolute, weights)
    for _ in range(_STEPS):
        normal = jacobian.T @ jacobian
        normal.flat[:: len(normal) + 1] += damping * normal.diagonal() + 1e-15
        step = np.zeros(4)
        step[: jacobian.shape[1]] = np.linalg.lstsq(normal, jacobian.T @ residual, rcond=None)[0]
        moved, by = _residual(local, reading, state + step, absolute, weights)
        before, after = residual @ residual, moved @ moved
        if after <= before:
            state, residual, jacobian, damping = state + step, moved, by, damping / 10
            # lengths that belong to no place lead ever farther away, and fit little better there
            if after > (1 - _CREEPS) * before:
                break
        else:
            damping = max(10 * damping, 1e-6)
        # beside the rounding of the residuals shorter steps are refused and tried again without end
        if np.abs(step).max() < _ARRIVED:
            break
    return state


def _residual(
    local: Array, reading: Array, state: Array, absolute: bool, weights: Array | float = 1.0
) -> tuple[Array, Array]:
    """Return `l + l0 - |x - x0|` and the derivatives of the prediction by the free unknowns, both times the weights."""
    away = local - state[:3]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    towards = -away / distance[:, None]
    jacobian = towards if absolute else np.column_stack([towards, -np.ones(len(distance))])
    return weights * (reading + state[3] - distance), (weights * jacobian.T).T
